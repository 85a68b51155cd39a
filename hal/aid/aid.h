// One interface to what knows metres beside the camera: rangefinder, barometer, satellites; from the bus, from files,
// or from simulation.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>

#include "hal/rt/time.h"

namespace godwit::hal {

enum class AidKind : std::uint8_t { kRange, kBarometer, kSatellites };
constexpr int kAidKinds = 3;
/// "range", "baro", "gnss": as options, files and reports call them.
constexpr const char* aid_name(AidKind kind) {
  constexpr std::array<const char*, kAidKinds> kNames = {"range", "baro", "gnss"};
  return kNames[static_cast<std::size_t>(kind)];
}

/// Height at which the standard atmosphere has a pressure (ICAO Doc 7488, troposphere) [m]. Pressure above 0 [Pa].
inline double pressure_height_m(double pressure_pa) {
  return (1 - std::pow(pressure_pa / 101325.0, 1 / 5.25588)) / 2.25577e-5;
}
/// The troposphere ends there: a pressure outside is no height, and no unit but Pa.
constexpr double kLeastPressurePa = 22632, kMostPressurePa = 120000;
/// One sigma of a rangefinder's distance and of a height by pressure, where the source does not say it [m]. A lidar's
/// data sheet; MS5611 at its highest oversampling is 0.1 m.
constexpr double kRangeSigmaM = 0.05, kPressureSigmaM = 0.15;

struct AidSample {
  AidKind kind = AidKind::kRange;
  rt::TimeNs t_ns = 0;
  /// Satellites: place in a local frame with z up whose origin the source keeps. Barometer: z, height by the pressure
  /// of the standard atmosphere. Rangefinder: z, distance along its beam. [m]
  std::array<double, 3> value_m{};
  double sigma_m = 0;  ///< one sigma of each axis
};

/// What has come, without waiting. One thread calls it. No allocation, no lock.
class AidSource {
 public:
  virtual ~AidSource() = default;
  /// The oldest that waits, if it was measured at or before t_ns. False: there is none. Each kind in the order of its
  /// times.
  virtual bool next_until(rt::TimeNs t_ns, AidSample* sample) = 0;
};

}  // namespace godwit::hal
