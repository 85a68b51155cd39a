// The simulated camera as a run needs it: from and to a picture, at a pace, rendered ahead if wished, with its truth.
#pragma once

#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include "firmware_app/sim/truth_masks.h"
#include "hal/replay_time.h"
#include "hal/rt/result.h"
#include "hal/sim/flight/flight.h"

namespace godwit::app {

struct FlownCameraOptions {
  std::int64_t start = 0;   ///< pictures left out at the beginning
  std::int64_t frames = 0;  ///< 0: all
  bool real_pace = false;   ///< pictures come at their capture times
  bool truth_masks = false;
  hal::ReplayTime* time = nullptr;  ///< told when the first picture is captured; may be null
};

/// The flight outlives it. One thread calls next; masks() is asked by the tracker's.
class FlownCamera final : public hal::Camera {
 public:
  FlownCamera(const sim::Flight& flight, const FlownCameraOptions& options);

  /// Draws all pictures into memory, so that the flight shares the processor with nothing. Error: there is too little
  /// memory, or *stop became true.
  rt::Result<void> render_ahead(const std::atomic<bool>& stop);

  int width() const override { return camera_->width(); }
  int height() const override { return camera_->height(); }
  int channels() const override { return camera_->channels(); }
  hal::CameraStatus next(const rt::MutableImageView& grey, std::uint8_t* bgr, rt::TimeNs timeout_ns,
                         hal::CapturedFrame* frame, std::string* why) override;

  int left() const { return left_; }  ///< pictures still to come
  /// The true boxes as masks; null if they were not asked for.
  MaskSource* masks() { return masks_.get(); }
  /// boxes.csv of all pictures given out so far.
  const std::string& boxes() const { return boxes_; }

 private:
  /// A picture that was drawn, or why there is none.
  struct Drawn {
    hal::CameraStatus status = hal::CameraStatus::kEnd;
    hal::CapturedFrame frame;
    std::string why;
    std::vector<sim::TrueBox> boxes;
    std::unique_ptr<std::uint8_t[]> pixels;  ///< rendered ahead only; rows without padding
  };
  void draw(const rt::MutableImageView& grey, Drawn* drawn);
  void fetch(const rt::MutableImageView& grey, Drawn* drawn);

  std::unique_ptr<sim::SimCamera> camera_;
  std::unique_ptr<TruthMasks> masks_;
  const bool real_pace_;
  const rt::TimeNs read_after_ns_;  ///< from the capture time to the last row
  hal::ReplayTime* const time_;
  int first_ = 0, left_ = 0;
  std::vector<Drawn> ahead_;    ///< empty: drawn when asked for
  std::size_t next_ahead_ = 0;  ///< the next one to give out
  rt::TimeNs start_ns_ = 0;
  std::string boxes_;
};

}  // namespace godwit::app
