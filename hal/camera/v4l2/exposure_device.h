// A V4L2 device's exposure and gain in nanoseconds and factors, whatever its controls count in.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "hal/camera/exposure_control.h"
#include "hal/camera/v4l2/v4l2_controls.h"

namespace godwit::hal {

enum class ExposureMode : std::uint8_t {
  kOff,       ///< left to the device and to the controls that are set at its start
  kFixed,     ///< set at its start
  kAutomatic  ///< steered by the pictures' brightness
};

/// Who sets the exposure, and what the controls count in.
struct ExposurePlan {
  ExposureMode mode = ExposureMode::kOff;
  Exposure fixed;                              ///< of kFixed; exposure_ns 0: left as it is
  ExposureSettings automatic;                  ///< of kAutomatic; limits of the device narrow it
  std::string exposure_control, gain_control;  ///< see V4l2Controls::find; empty: the usual ones
  /// What one step of the exposure control is. 0: 100 us of V4L2_CID_EXPOSURE_ABSOLUTE, 1 us of Tegra's, and of
  /// V4L2_CID_EXPOSURE a line: (width + V4L2_CID_HBLANK) / V4L2_CID_PIXEL_RATE where the device has both.
  rt::TimeNs exposure_unit_ns = 0;
  double gain_one = 0;      ///< value of the gain control at gain 1; 0: its lowest (at least 1)
  double gain_step_db = 0;  ///< a step multiplies the gain by so many decibels; 0: gain = value / gain_one
};

/// One open device's. Asks and sets by the driver, which may block; one thread.
class ExposureDevice {
 public:
  /// Finds the controls; where they are to be set, switches off what the device would do itself. What cannot be done is
  /// told in notes, in words, and left.
  ExposureDevice(const V4l2Controls& controls, const ExposurePlan& plan, int width, std::vector<std::string>* notes);

  /// Now set; nothing: the device does not say, or in units that nobody knows.
  std::optional<rt::TimeNs> exposure_ns() const;
  std::optional<double> gain() const;
  /// Sets both as near as the device has it. Returns what is set: the exposure is rounded down to its steps, and the
  /// gain makes up for it. Where it has neither, what is said to be set is what was.
  Exposure apply(const Exposure& wanted, const Exposure& now) const;
  bool has_exposure() const { return unit_ns_ > 0; }
  bool has_gain() const { return gain_.has_value(); }
  rt::TimeNs least_ns() const { return exposure_->low * unit_ns_; }  ///< precondition: has_exposure()
  rt::TimeNs most_ns() const { return exposure_->high * unit_ns_; }  ///< the same
  double most_gain() const { return gain_of(gain_->high); }          ///< precondition: has_gain()

 private:
  void take_over(std::vector<std::string>* notes) const;
  void find_exposure(const ExposurePlan& plan, int width, std::vector<std::string>* notes);
  void find_gain(const ExposurePlan& plan, std::vector<std::string>* notes);
  double gain_of(std::int64_t value) const;
  std::int64_t value_of(double gain) const;

  const V4l2Controls& controls_;
  std::optional<V4l2Control> exposure_, gain_;
  rt::TimeNs unit_ns_ = 0;  ///< 0: the exposure cannot be set
  double gain_one_ = 1, gain_step_db_ = 0;
};

}  // namespace godwit::hal
