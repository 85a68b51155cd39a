// godwit-record-yardstick: whether the recorder keeps up with a camera: pictures of a sequence, held in memory, at 60
// Hz into a folder, and how many were dropped.
//   godwit-record-yardstick SEQUENCE OUT [SECONDS]
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <vector>

#include "firmware_app/output/recorder.h"
#include "hal/camera/replay/replay_camera.h"
#include "hal/rt/wake_up.h"

namespace {
using namespace godwit;

constexpr rt::TimeNs kIntervalNs = 16'666'667;
constexpr std::size_t kPictures = 100;

/// Gives the pictures at its own pace; one that nobody takes in time is left out of the sequence, as a driver does.
class PacedCamera final : public hal::Camera {
 public:
  PacedCamera(std::vector<std::vector<std::uint8_t>> pictures, int width, int height)
      : pictures_(std::move(pictures)), width_(width), height_(height), begin_ns_(rt::monotonic_now_ns()) {}
  int width() const override { return width_; }
  int height() const override { return height_; }
  int channels() const override { return 1; }
  hal::CameraStatus next(const rt::MutableImageView& grey, std::uint8_t* /*bgr*/, rt::TimeNs /*timeout_ns*/,
                         hal::CapturedFrame* frame, std::string* /*why*/) override {
    const rt::TimeNs now_ns = rt::monotonic_now_ns();
    if (now_ns - due_ns() > 6 * kIntervalNs) number_ = (now_ns - begin_ns_) / kIntervalNs;  // a driver's buffers
    rt::sleep_until_ns(due_ns());
    frame->sequence = static_cast<std::uint32_t>(number_);
    frame->t_capture_ns = due_ns();
    const std::vector<std::uint8_t>& picture = pictures_[static_cast<std::size_t>(number_) % pictures_.size()];
    ++number_;
    if (grey.data == nullptr) return hal::CameraStatus::kFrame;
    for (int y = 0; y < height_; ++y) std::copy_n(picture.data() + y * width_, width_, grey.row(y));
    return hal::CameraStatus::kFrame;
  }

 private:
  rt::TimeNs due_ns() const { return begin_ns_ + number_ * kIntervalNs; }

  const std::vector<std::vector<std::uint8_t>> pictures_;
  const int width_, height_;
  const rt::TimeNs begin_ns_;
  std::int64_t number_ = 0;
};

}  // namespace

int main(int argc, char** argv) {
  if (argc < 3) return std::puts("godwit-record-yardstick SEQUENCE OUT [SECONDS]"), 2;
  auto source = hal::ReplayCamera::open(argv[1], {});
  if (!source) return std::printf("%s\n", source.error().message.c_str()), 2;
  hal::ReplayCamera& replay = *source.value();
  const int width = replay.width(), height = replay.height();
  std::vector<std::vector<std::uint8_t>> pictures;
  while (pictures.size() < kPictures) {
    std::vector<std::uint8_t> pixels(static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
    hal::CapturedFrame frame;
    const auto status = replay.next({pixels.data(), width, height, width}, nullptr, 0, &frame, nullptr);
    if (status == hal::CameraStatus::kEnd) break;
    if (status == hal::CameraStatus::kFrame) pictures.push_back(std::move(pixels));
  }
  if (pictures.empty()) return std::puts("no pictures"), 2;
  PacedCamera camera(std::move(pictures), width, height);
  app::RecorderOptions options;
  options.out = argv[2];
  options.seconds = argc > 3 ? std::atof(argv[3]) : 20;
  const std::atomic<bool> stop{false};
  const auto done = app::record_devices(&camera, nullptr, options, {}, stop);
  if (!done) return std::printf("%s\n", done.error().message.c_str()), 1;
  const app::Recorded& r = done.value();
  std::printf(
      "%dx%d at 60 Hz for %.1f s: %llu pictures, %llu dropped, %llu missed; %.1f ms of one processor a picture\n",
      width, height, r.seconds, static_cast<unsigned long long>(r.pictures), static_cast<unsigned long long>(r.dropped),
      static_cast<unsigned long long>(r.missed),
      1e3 * static_cast<double>(std::clock()) / CLOCKS_PER_SEC / static_cast<double>(r.pictures));
  return r.dropped + r.missed == 0 ? 0 : 1;
}
