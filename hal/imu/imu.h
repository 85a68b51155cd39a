// One interface to every inertial sensor: replay, MPU-6000 over spidev, IIO, simulation.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "hal/rt/log_ring.h"
#include "hal/rt/time.h"

namespace godwit::hal {

/// One reading in the sensor's frame, which is the body frame: x forward, y right, z down (FRD) unless a recording says
/// otherwise. Trivially copyable: it travels through rings.
struct ImuSample {
  rt::TimeNs t_ns = 0;                 ///< when it was measured, CLOCK_MONOTONIC (replay, simulation: rebased)
  std::array<double, 3> gyro_rad_s{};  ///< angular rate
  std::array<double, 3> accel_m_s2{};  ///< specific force: a sensor at rest and level reads (0, 0, -9.81) in FRD
  std::uint8_t flags = 0;              ///< ImuFlag, or-ed: what the device knows to be wrong
};

/// What a sensor says against its own sample.
enum ImuFlag : std::uint8_t {
  kImuGap = 1,             ///< samples before this one are missing: its buffer ran over, or it was started anew
  kImuGyroSaturated = 2,   ///< an axis stands at the end of its range: the true rate is larger
  kImuAccelSaturated = 4,  ///< the same of the acceleration
};

/// Whether a sensor that flies can have measured that: numbers, and no larger than any that there is. No allocation.
inline bool possible(const ImuSample& s) {
  constexpr double kMostRate = 100, kMostForce = 1000;  // [rad/s, m/s^2]
  for (std::size_t i = 0; i < 3; ++i) {
    if (!(std::abs(s.gyro_rad_s[i]) <= kMostRate) || !(std::abs(s.accel_m_s2[i]) <= kMostForce)) return false;
  }
  return true;
}

/// Flags of a sample one axis of which stands at the end of its range; a range of 0 is not known. Sensors of 12 bits,
/// the fewest there are, end one part in 2048 before it. No allocation.
inline std::uint8_t saturated_flags(const ImuSample& s, double gyro_range_rad_s, double accel_range_m_s2) {
  constexpr double kEnd = 2047.0 / 2048;
  std::uint8_t flags = 0;
  for (std::size_t i = 0; i < 3; ++i) {
    if (gyro_range_rad_s > 0 && std::abs(s.gyro_rad_s[i]) >= kEnd * gyro_range_rad_s) flags |= kImuGyroSaturated;
    if (accel_range_m_s2 > 0 && std::abs(s.accel_m_s2[i]) >= kEnd * accel_range_m_s2) flags |= kImuAccelSaturated;
  }
  return flags;
}

/// Where a sensor's axes end; 0: not known.
struct ImuRanges {
  double gyro_rad_s = 0, accel_m_s2 = 0;
};

/// What became of one call of Imu::next.
enum class ImuStatus : std::uint8_t {
  kSample,   ///< a sample was delivered
  kTimeout,  ///< nothing came in time
  kFault,    ///< the device answered, but with nonsense, or did not answer; the next call may succeed
  kEnd       ///< the source is at its end
};

/// A source of samples in the order of their times. One thread calls it. No allocation in next.
class Imu {
 public:
  virtual ~Imu() = default;
  virtual double rate_hz() const = 0;
  /// The thread of next(), or after its end.
  virtual ImuRanges ranges() const { return {}; }
  /// Writes the next sample. Waits at most timeout_ns.
  virtual ImuStatus next(ImuSample* sample, rt::TimeNs timeout_ns) = 0;
  /// What the device has to say beside its samples; null: nothing. The thread of next() writes, one other may read.
  virtual rt::LogRing* events() { return nullptr; }
};

}  // namespace godwit::hal
