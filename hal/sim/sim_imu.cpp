#include "hal/sim/sim_imu.h"

#include <algorithm>
#include <cmath>

namespace godwit::sim {
namespace {
double measured(double value, double range, bool quantise) {
  const double v = std::clamp(value, -range, range);
  const double lsb = range / 32768.0;
  return quantise ? std::clamp(std::round(v / lsb), -32768.0, 32767.0) * lsb : v;
}
}  // namespace

SimImu::SimImu(const Trajectory& trajectory, const ImuModel& model, rt::TimeNs start_ns, std::uint64_t seed)
    : trajectory_(trajectory), model_(model), start_ns_(start_ns), rng_(seed, 0x1407) {
  for (int i = 0; i < 3; ++i) truth_.gyro_bias_rad_s[i] = model_.gyro_bias * rng_.gaussian();
  for (int i = 0; i < 3; ++i) truth_.accel_bias_m_s2[i] = model_.accel_bias * rng_.gaussian();
}

hal::ImuStatus SimImu::next(hal::ImuSample* sample, rt::TimeNs) {
  const double dt = 1.0 / model_.rate_hz, t = static_cast<double>(index_) * dt;
  if (t > trajectory_.duration_s()) return hal::ImuStatus::kEnd;
  const BodyState state = trajectory_.at(t);
  truth_.gyro_rad_s = state.omega_rad_s;
  truth_.accel_m_s2 = state.specific_force_m_s2;
  // White noise of density n, sampled at rate f without a filter's correlation, has a standard deviation of n sqrt(f).
  const double root = std::sqrt(model_.rate_hz), walk = std::sqrt(dt);
  sample->t_ns = start_ns_ + static_cast<rt::TimeNs>(std::llround(t * 1e9));
  for (int i = 0; i < 3; ++i) {
    if (index_ > 0) {
      truth_.gyro_bias_rad_s[i] += model_.gyro_bias_walk * walk * rng_.gaussian();
      truth_.accel_bias_m_s2[i] += model_.accel_bias_walk * walk * rng_.gaussian();
    }
    const double gyro = truth_.gyro_rad_s[i] + truth_.gyro_bias_rad_s[i] + model_.gyro_noise * root * rng_.gaussian();
    const double accel = truth_.accel_m_s2[i] + truth_.accel_bias_m_s2[i] + model_.accel_noise * root * rng_.gaussian();
    const std::size_t k = static_cast<std::size_t>(i);
    sample->gyro_rad_s[k] = measured(gyro, model_.gyro_range_rad_s, model_.quantise);
    sample->accel_m_s2[k] = measured(accel, model_.accel_range_m_s2, model_.quantise);
  }
  ++index_;
  return hal::ImuStatus::kSample;
}

}  // namespace godwit::sim
