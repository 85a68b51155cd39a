// What the automatic exposure asks of a device: exposure and gain in nanoseconds and factors, whatever its controls
// count in.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "hal/camera/device/exposure_control.h"
#include "hal/rt/time.h"

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
  std::string exposure_control, gain_control;  ///< the device's names for them; empty: the usual ones
  /// What one step of the exposure control is; 0: as the device says, or as is usual for the control.
  rt::TimeNs exposure_unit_ns = 0;
  double gain_one = 0;      ///< value of the gain control at gain 1; 0: its lowest (at least 1)
  double gain_step_db = 0;  ///< a step multiplies the gain by so many decibels; 0: gain = value / gain_one
};

/// One open device's. Asks and sets by the driver, which may block; one thread.
class ExposureDevice {
 public:
  virtual ~ExposureDevice() = default;
  /// Now set; nothing: the device does not say, or in units that nobody knows.
  virtual std::optional<rt::TimeNs> exposure_ns() const = 0;
  virtual std::optional<double> gain() const = 0;
  /// Sets both as near as the device has it. Returns what is set: the exposure is rounded down to its steps, and the
  /// gain makes up for it. Where it has neither, what is said to be set is what was.
  virtual Exposure apply(const Exposure& wanted, const Exposure& now) const = 0;
  virtual bool has_exposure() const = 0;
  virtual bool has_gain() const = 0;
  virtual rt::TimeNs least_ns() const = 0;  ///< precondition: has_exposure()
  virtual rt::TimeNs most_ns() const = 0;   ///< the same
  virtual double most_gain() const = 0;     ///< precondition: has_gain()
};

}  // namespace godwit::hal
