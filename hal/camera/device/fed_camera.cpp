#include "hal/camera/device/fed_camera.h"

#include <cstring>

#include "hal/rt/process_end.h"

namespace godwit::hal {

FedCamera::FedCamera(std::unique_ptr<Camera> inner) : inner_(std::move(inner)), channels_(inner_->channels()) {
  const std::size_t pixels = inner_->width() * inner_->height();
  for (std::size_t i = 0; i < kPictures; ++i) {
    pictures_[i].grey.resize(pixels);
    if (channels_ == 3) pictures_[i].bgr.resize(3 * pixels);
    pictures_[i].why.reserve(256);
    free_.try_push(static_cast<int>(i));
  }
}

rt::Result<std::unique_ptr<FedCamera>> FedCamera::start(std::unique_ptr<Camera> inner, const rt::ThreadPlan& plan) {
  std::unique_ptr<FedCamera> out(new FedCamera(std::move(inner)));
  FedCamera* const self = out.get();
  if (auto started = self->feeder_.start("gw-feeder", plan, [self] { self->feed(); }); !started) return started.error();
  return out;
}

FedCamera::~FedCamera() {
  // Relaxed: it only ends the loop; join() orders the rest.
  stop_.store(true, std::memory_order_relaxed);
  rt::join_in_time(&feeder_);
}

void FedCamera::feed() {
  Picture nowhere;
  while (!stop_.load(std::memory_order_relaxed)) {
    int index = -1;
    Picture* to = &nowhere;
    rt::MutableImageView grey;
    if (const int* const place = free_.front()) {
      index = *place;
      to = &pictures_[index];
      grey = {to->grey.data(), inner_->width(), inner_->height(), inner_->width()};
    }
    std::uint8_t* const bgr = to->bgr.empty() ? nullptr : to->bgr.data();
    const CameraStatus status = inner_->next(grey, bgr, kWaitNs, &to->frame, &to->why);
    if (status == CameraStatus::kTimeout) continue;
    if (index < 0 && status != CameraStatus::kEnd) {
      passed_over_.fetch_add(1, std::memory_order_relaxed);
      continue;
    }
    if (index >= 0) free_.drop_front();
    done_.try_push({status, index});
    caller_wake_.post();
    if (status == CameraStatus::kEnd) return;
  }
}

CameraStatus FedCamera::hand_over(const Done& done, const rt::MutableImageView& grey, std::uint8_t* bgr,
                                  CapturedFrame* frame, std::string* why) {
  if (done.picture < 0) return done.status;
  const Picture& p = pictures_[done.picture];
  *frame = p.frame;
  if (done.status == CameraStatus::kBadFrame && why != nullptr) why->assign(p.why);
  if (done.status == CameraStatus::kFrame && grey.data != nullptr) {
    for (int y = 0; y < grey.height; ++y) {
      std::memcpy(grey.row(y), p.grey.data() + static_cast<std::ptrdiff_t>(y) * grey.width, grey.width);
    }
    if (bgr != nullptr && !p.bgr.empty()) std::memcpy(bgr, p.bgr.data(), p.bgr.size());
  }
  free_.try_push(done.picture);
  return done.status;
}

CameraStatus FedCamera::next(const rt::MutableImageView& grey, std::uint8_t* bgr, rt::TimeNs timeout_ns,
                             CapturedFrame* frame, std::string* why) {
  Done done;
  const rt::TimeNs give_up_ns = rt::monotonic_now_ns() + timeout_ns;
  // More posts than pictures: of those that were taken without a wait.
  while (!done_.try_pop(&done)) {
    const rt::TimeNs left_ns = give_up_ns - rt::monotonic_now_ns();
    if (left_ns <= 0) return CameraStatus::kTimeout;
    caller_wake_.wait_for(left_ns);
  }
  return hand_over(done, grey, bgr, frame, why);
}

}  // namespace godwit::hal
