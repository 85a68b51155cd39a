// The inertial sensor of a simulated flight: truth, white noise, wandering bias, saturation, quantisation.
#pragma once

#include <cstdint>

#include "hal/imu/imu.h"
#include "hal/sim/random.h"
#include "hal/sim/trajectory.h"

namespace godwit::sim {

/// Defaults: MPU-6000 (InvenSense PS-MPU-6000A, rev. 3.4, tables 6.1 and 6.2): gyro 0.005 deg/s/sqrt(Hz), accelerometer
/// 400 ug/sqrt(Hz), full scales 2000 deg/s and 16 g with 16 bits. The data sheet gives no bias walk: the values are
/// those usual for this class of sensor. Start bias: what a calibration before take-off leaves.
struct ImuModel {
  double rate_hz = 200;
  double gyro_noise = 8.73e-5;      ///< [rad/s/sqrt(Hz)]
  double accel_noise = 3.92e-3;     ///< [m/s^2/sqrt(Hz)]
  double gyro_bias_walk = 2.0e-5;   ///< [rad/s^2/sqrt(Hz)]
  double accel_bias_walk = 1.0e-4;  ///< [m/s^3/sqrt(Hz)]
  double gyro_bias = 2.0e-3;        ///< one sigma of the start bias [rad/s]
  double accel_bias = 5.0e-2;       ///< one sigma of the start bias [m/s^2]
  double gyro_range_rad_s = 34.906585;
  double accel_range_m_s2 = 156.9064;
  bool quantise = true;  ///< 16 bits over the range
};

/// What the sensor added to the truth of its newest sample, for tests and logs.
struct ImuTruth {
  Vec3 gyro_rad_s, accel_m_s2;            ///< ideal
  Vec3 gyro_bias_rad_s, accel_bias_m_s2;  ///< bias alone
};

/// Samples at multiples of 1/rate from start_ns to the trajectory's end. The trajectory must outlive it.
class SimImu final : public hal::Imu {
 public:
  SimImu(const Trajectory& trajectory, const ImuModel& model, rt::TimeNs start_ns, std::uint64_t seed);
  double rate_hz() const override { return model_.rate_hz; }
  /// Never waits. No allocation.
  hal::ImuStatus next(hal::ImuSample* sample, rt::TimeNs timeout_ns) override;
  const ImuTruth& truth() const { return truth_; }

 private:
  const Trajectory& trajectory_;
  ImuModel model_;
  rt::TimeNs start_ns_;
  Rng rng_;
  std::int64_t index_ = 0;
  ImuTruth truth_;
};

}  // namespace godwit::sim
