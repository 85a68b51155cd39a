// The inertial sensor of a simulated flight: truth, white noise, wandering bias, saturation, quantisation; and, where a
// scenario asks for them, the faults of real ones: low-pass delay, clock jitter, a crooked mounting, biases that ramp.
#pragma once

#include <cstdint>

#include "hal/imu/imu.h"
#include "hal/sim/world/random.h"
#include "hal/sim/world/trajectory.h"

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
  // Faults, none by default. Which way they go is drawn by seed, from streams of their own: without them the samples
  // are the same to the bit.
  double noise_times = 1;         ///< its noise and its biases' walks are so many times what is said above
  double delay_ms = 0;            ///< group delay of the sensor's low-pass (two equal poles); the time told is not late
  double clock_jitter_ms = 0;     ///< one sigma of the time told; times keep their order
  double mounting_error_deg = 0;  ///< the sensor is turned by so much about some axis
  double gyro_bias_ramp = 0;      ///< one sigma of how fast each bias goes on rising, as while warming up [rad/s^2]
  double accel_bias_ramp = 0;     ///< [m/s^3]
};

/// What an estimator that takes its data sheet at its word is not made for: twice the noise, biases that ramp, a
/// low-pass of 3 ms, 0.5 ms of jitter, 1.5 degrees of crookedness.
ImuModel with_usual_faults(ImuModel model);

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
  hal::ImuRanges ranges() const override { return {model_.gyro_range_rad_s, model_.accel_range_m_s2}; }
  /// Never waits. No allocation.
  hal::ImuStatus next(hal::ImuSample* sample, rt::TimeNs timeout_ns) override;
  const ImuTruth& truth() const { return truth_; }
  const Mat3& R_sensor_body() const { return R_sensor_body_; }

 private:
  void filter_to(double t, Vec3* gyro, Vec3* accel);
  rt::TimeNs told_time(double t);

  const Trajectory& trajectory_;
  ImuModel model_;
  rt::TimeNs start_ns_;
  Rng rng_;
  std::int64_t index_ = 0;
  ImuTruth truth_;
  Mat3 R_sensor_body_ = Mat3::Identity();
  Vec3 gyro_ramp_, accel_ramp_;
  // The low-pass: rates and forces after each of the two poles, and up to when.
  Eigen::Matrix<double, 6, 1> pole_[2];
  double t_filtered_ = -1;
  Rng clock_rng_;
};

}  // namespace godwit::sim
