#include "firmware_app/sim/looped_pictures.h"

#include <algorithm>
#include <cstring>

#include "hal/rt/wake_up.h"

namespace godwit::app {

rt::Result<std::unique_ptr<LoopedPictures>> LoopedPictures::record(hal::Camera* source, int pictures,
                                                                   const Options& options,
                                                                   const std::atomic<bool>& stop) {
  std::unique_ptr<LoopedPictures> out(new LoopedPictures(source->width(), source->height(), options));
  const std::size_t bytes = source->width() * source->height();
  out->pixels_ = std::make_shared<std::vector<std::uint8_t>>();
  out->pixels_->reserve(bytes * pictures);
  hal::CameraStatus status = hal::CameraStatus::kFrame;
  while (out->count_ < pictures && status != hal::CameraStatus::kEnd) {
    if (stop.load(std::memory_order_relaxed)) return rt::Error{"interrupted while the pictures were made"};
    out->pixels_->resize(bytes * (out->count_ + 1));
    const rt::MutableImageView grey{out->pixels_->data() + bytes * out->count_, source->width(), source->height(),
                                    source->width()};
    hal::CapturedFrame frame;
    status = source->next(grey, nullptr, rt::kNsPerSecond, &frame, nullptr);
    if (status != hal::CameraStatus::kFrame) continue;
    out->times_.push_back(frame.t_capture_ns);
    ++out->count_;
  }
  if (out->count_ < 2) {
    return rt::Error{"the source has " + std::to_string(out->count_) + " pictures; a flight needs two at least"};
  }
  return out;
}

std::unique_ptr<LoopedPictures> LoopedPictures::again(const Options& options) const {
  std::unique_ptr<LoopedPictures> out(new LoopedPictures(width_, height_, options));
  out->pixels_ = pixels_;
  out->count_ = count_;
  out->times_ = times_;
  return out;
}

hal::CameraStatus LoopedPictures::next(const rt::MutableImageView& grey, std::uint8_t* /*bgr*/, rt::TimeNs timeout_ns,
                                       hal::CapturedFrame* frame, std::string* /*why*/) {
  if (options_.total > 0 && next_ >= options_.total) return hal::CameraStatus::kEnd;
  if (options_.once != nullptr && next_ >= count_) return hal::CameraStatus::kEnd;
  if (start_ns_ == 0) {
    start_ns_ = options_.real_pace ? rt::monotonic_now_ns() + options_.interval_ns : rt::kNsPerSecond;
    if (options_.once != nullptr) options_.once->pin(times_.front(), start_ns_);
  }
  const rt::TimeNs due =
      start_ns_ + (options_.once != nullptr ? times_[next_] - times_.front() : next_ * options_.interval_ns);
  if (options_.real_pace) {
    const rt::TimeNs give_up = rt::monotonic_now_ns() + timeout_ns;
    const rt::TimeNs delivery = due + options_.delivery_ns;
    rt::sleep_until_ns(std::min(delivery, give_up));
    if (delivery > give_up) return hal::CameraStatus::kTimeout;
  }
  // 0 1 2 3 2 1 0 1 ..
  const std::int64_t period = 2 * (static_cast<std::int64_t>(count_) - 1);
  const std::int64_t place = next_ % period;
  const std::size_t picture = place < count_ ? place : period - place;
  frame->t_capture_ns = due;
  frame->t_source_ns = due - start_ns_;
  frame->sequence = static_cast<std::uint32_t>(next_++);
  if (grey.data == nullptr) return hal::CameraStatus::kFrame;
  const std::size_t row_bytes = width_;
  const std::uint8_t* from = pixels_->data() + picture * row_bytes * height_;
  for (int y = 0; y < height_; ++y) std::memcpy(grey.row(y), from + y * row_bytes, row_bytes);
  return hal::CameraStatus::kFrame;
}

}  // namespace godwit::app
