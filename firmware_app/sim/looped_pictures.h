// Pictures held in memory and flown forth and back, as long as one likes: a camera that costs nothing.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include "hal/camera/camera.h"
#include "hal/replay_time.h"

namespace godwit::app {

/// Real-time: next() copies a picture and, at real pace, sleeps until it is due. Capture times go on in even steps,
/// also where the flight turns, so the turn is no jump (but see Options::once). One thread.
class LoopedPictures final : public hal::Camera {
 public:
  struct Options {
    rt::TimeNs interval_ns = 33'333'333;  ///< between two pictures
    std::int64_t total = 0;               ///< pictures to deliver; 0: no end
    bool real_pace = true;                ///< next() returns when the picture is due; false: at once
    /// Real pace: a picture is delivered so long after its capture time, as exposure, readout and transfer take.
    rt::TimeNs delivery_ns = 0;
    /// Not forth and back but once, forth, in the steps that the source had: for a camera beside which something else
    /// was recorded. Told where the first picture lies on the clock; outlives the camera. Null: forth and back.
    hal::ReplayTime* once = nullptr;
  };

  /// Takes up to `pictures` pictures from the source, leaving bad ones out. Error: fewer than two came, or stopped.
  static rt::Result<std::unique_ptr<LoopedPictures>> record(hal::Camera* source, int pictures, const Options& options,
                                                            const std::atomic<bool>& stop);

  /// Another camera on the same pictures, from their beginning.
  std::unique_ptr<LoopedPictures> again(const Options& options) const;

  int width() const override { return width_; }
  int height() const override { return height_; }
  int channels() const override { return 1; }
  bool real_time() const override { return true; }
  hal::CameraStatus next(const rt::MutableImageView& grey, std::uint8_t* bgr, rt::TimeNs timeout_ns,
                         hal::CapturedFrame* frame, std::string* why) override;

  int pictures() const { return count_; }

 private:
  LoopedPictures(int width, int height, const Options& options) : width_(width), height_(height), options_(options) {}

  const int width_, height_;
  const Options options_;
  std::shared_ptr<std::vector<std::uint8_t>> pixels_;  ///< one picture after the other, without padding
  std::vector<rt::TimeNs> times_;                      ///< of each picture, as the source had them
  int count_ = 0;
  std::int64_t next_ = 0;
  rt::TimeNs start_ns_ = 0;  ///< capture time of picture 0
};

}  // namespace godwit::app
