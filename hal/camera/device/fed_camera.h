// A camera that may not be read on the frame path, read on a thread of its own: MJPEG, libcamera.
#pragma once

#include <array>
#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include "hal/camera/camera.h"
#include "hal/rt/spsc_ring.h"
#include "hal/rt/thread.h"
#include "hal/rt/wake_up.h"

namespace godwit::hal {

/// Reads another camera on a feeder thread, which may decode, allocate and wait, into a few pictures of its own; next()
/// copies the oldest of them and neither allocates nor locks. Where nobody takes them in time, pictures are passed over
/// by the inner camera and counted there.
class FedCamera final : public Camera {
 public:
  /// plan: of the feeder thread. Error: no thread.
  static rt::Result<std::unique_ptr<FedCamera>> start(std::unique_ptr<Camera> inner, const rt::ThreadPlan& plan);
  ~FedCamera() override;

  int width() const override { return inner_->width(); }
  int height() const override { return inner_->height(); }
  int channels() const override { return channels_; }
  bool real_time() const override { return true; }
  CameraStatus next(const rt::MutableImageView& grey, std::uint8_t* bgr, rt::TimeNs timeout_ns, CapturedFrame* frame,
                    std::string* why) override;
  void turning(double rate_rad_s) override { inner_->turning(rate_rad_s); }
  rt::LogRing* events() override { return inner_->events(); }

  Camera& inner() { return *inner_; }
  /// Pictures that came and for which no place was free. Any thread.
  std::uint64_t passed_over() const { return passed_over_.load(std::memory_order_relaxed); }

 private:
  static constexpr std::size_t kPictures = 4;
  /// How long the feeder waits at once: it looks whether it is to end.
  static constexpr rt::TimeNs kWaitNs = 50 * rt::kNsPerMs;

  struct Picture {
    std::vector<std::uint8_t> grey, bgr;
    CapturedFrame frame;
    std::string why;
  };
  /// What became of one call of the inner next(); picture: -1 for one without.
  struct Done {
    CameraStatus status = CameraStatus::kTimeout;
    int picture = -1;
  };

  explicit FedCamera(std::unique_ptr<Camera> inner);
  void feed();
  CameraStatus hand_over(const Done& done, const rt::MutableImageView& grey, std::uint8_t* bgr, CapturedFrame* frame,
                         std::string* why);

  std::unique_ptr<Camera> inner_;
  const int channels_;
  std::array<Picture, kPictures> pictures_;
  rt::SpscRing<int, kPictures> free_;          ///< caller to feeder
  rt::SpscRing<Done, 8> done_;                 ///< feeder to caller; more than pictures, for the end
  std::atomic<std::uint64_t> passed_over_{0};  ///< a number alone
  std::atomic<bool> stop_{false};
  rt::WakeUp caller_wake_;
  rt::Thread feeder_;
};

}  // namespace godwit::hal
