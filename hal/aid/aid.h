// One interface to what knows metres or the vertical beside the camera: rangefinder, barometer, satellites, and
// somebody else's attitude; from the bus, from files, or from simulation.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>

#include "hal/rt/time.h"

namespace godwit::hal {

enum class AidKind : std::uint8_t { kRange, kBarometer, kSatellites, kAttitude };
constexpr int kAidKinds = 4;
constexpr int kLengthKinds = 3;  ///< the first ones: they know metres
/// "range", "baro", "gnss", "attitude": as options, files and reports call them.
constexpr const char* aid_name(AidKind kind) {
  constexpr std::array<const char*, kAidKinds> kNames = {"range", "baro", "gnss", "attitude"};
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
/// The same of a receiver's velocity, where a recording does not say it [m/s]: the data sheet of a u-blox NEO-M8 says
/// 0.05, of half of all.
constexpr double kSatelliteVelocitySigma = 0.1;
/// The same of an autopilot's roll and pitch [rad]: it takes what its accelerometer feels for gravity, and one of the
/// MPU-6000's grade has a bias of up to 0.15 m/s^2 (euroc_mh01's has): 0.9 degrees, which no mean takes away.
constexpr double kAttitudeSigmaRad = 0.0175;

/// Against gravity along the body's axes (front, right, down), of an attitude from there to north, east, down: a unit
/// quaternion w x y z. What it says of the heading is not in it.
inline std::array<double, 3> up_of_attitude(const std::array<double, 4>& q) {
  const double w = q[0], x = q[1], y = q[2], z = q[3];
  return {-2 * (x * z - w * y), -2 * (y * z + w * x), -(w * w - x * x - y * y + z * z)};
}

struct AidSample {
  AidKind kind = AidKind::kRange;
  rt::TimeNs t_ns = 0;
  /// Satellites: place in a local frame (east, north, up) whose origin the source keeps. Barometer: z, height by the
  /// pressure of the standard atmosphere. Rangefinder: z, distance along its beam. [m] Attitude: against gravity along
  /// the body's axes, unit length.
  std::array<double, 3> value{};
  double sigma = 0;  ///< one sigma of each axis [m]; attitude: [rad], shared by neighbours
  /// Satellites: velocity along the frame's x and y, and one sigma of each [m/s]; 0: not told.
  std::array<double, 2> velocity{};
  double velocity_sigma = 0;
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
