// Automatic exposure for sensors without an image processor: exposure first, as far as blur allows, then gain.
#pragma once

#include <array>
#include <cstdint>

#include "hal/rt/image.h"
#include "hal/rt/time.h"

namespace godwit::hal {

/// What a picture says of its exposure.
struct Brightness {
  double mean = 0;           ///< 0 to 255
  double clipped_share = 0;  ///< pixels at white
};
/// Of every eighth pixel of every eighth row. No allocation.
Brightness measure_brightness(const rt::ImageView& grey);

struct ExposureSettings {
  double target_mean = 100;  ///< a corner's contrast has room on both sides
  rt::TimeNs least_ns = 20'000;
  rt::TimeNs most_ns = 30 * rt::kNsPerMs;  ///< the frame interval, less the readout
  double most_gain = 16;
  double blur_px = 1.0;   ///< a corner may smear over so many pixels while the shutter is open
  double focal_px = 450;  ///< pixels a radian
};

struct Exposure {
  rt::TimeNs exposure_ns = 0;
  double gain = 1;
};

/// One call a frame. A change is judged when it must have come through: control delays differ from sensor to sensor (0
/// to kMostDelay frames) and are not told, and whoever corrects before a correction is seen swings. Pure; no
/// allocation.
class ExposureControl {
 public:
  /// A setting made after frame n is in frame n + 1 + delay.
  static constexpr int kMostDelay = 3;
  /// Brightness within this of the target is left alone: a wall and a window in turn would make it flicker.
  static constexpr double kDeadBand = 0.12;

  ExposureControl(const ExposureSettings& settings, const Exposure& start) : settings_(settings), now_(start) {}

  /// The picture that came, and how fast the camera turns (0: unknown or still). True: current() has changed, set it.
  bool frame(const Brightness& seen, double turn_rad_s);
  const Exposure& current() const { return now_; }
  /// What the device made of it: its controls go in steps.
  void applied(const Exposure& set) { now_ = set; }
  /// Longest exposure at this rate.
  rt::TimeNs limit_ns(double turn_rad_s) const;

 private:
  /// By how much to multiply the light.
  double correction(const Brightness& seen) const;
  Exposure split(double light_ns, double turn_rad_s) const;

  const ExposureSettings settings_;
  Exposure now_;
  int wait_ = 0;  ///< frames until the last change is seen for certain
};

}  // namespace godwit::hal
