#include "hal/sim/sensors/sim_imu.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

namespace godwit::sim {
namespace {
/// Longest step of the low-pass: what comes in is taken for straight within it. A 400 Hz shake still has ten steps.
constexpr double kFilterStepS = 0.25e-3;

Vec3 random_vector(Rng* rng) {
  Vec3 v;
  for (int i = 0; i < 3; ++i) v[i] = rng->gaussian();
  return v;
}

/// How far times may stray so that their order holds: less than half an interval.
double jitter_limit(double rate_hz) {
  return 0.45 / rate_hz;
}

double measured(double value, double range, bool quantise) {
  const double v = std::clamp(value, -range, range);
  const double lsb = range / 32768.0;
  return quantise ? std::clamp(std::round(v / lsb), -32768.0, 32767.0) * lsb : v;
}
}  // namespace

ImuModel with_usual_faults(ImuModel model) {
  model.noise_times = 2;
  model.delay_ms = 3;
  model.clock_jitter_ms = 0.5;
  model.mounting_error_deg = 1.5;
  model.gyro_bias_ramp = 5e-5;  // 3 mrad/s and 0.06 m/s^2 within a minute
  model.accel_bias_ramp = 1e-3;
  return model;
}

SimImu::SimImu(const Trajectory& trajectory, const ImuModel& model, rt::TimeNs start_ns, std::uint64_t seed)
    : trajectory_(trajectory), model_(model), start_ns_(start_ns), rng_(seed, 0x1407), clock_rng_(seed, 0x1407c) {
  for (int i = 0; i < 3; ++i) truth_.gyro_bias_rad_s[i] = model_.gyro_bias * rng_.gaussian();
  for (int i = 0; i < 3; ++i) truth_.accel_bias_m_s2[i] = model_.accel_bias * rng_.gaussian();
  Rng faults(seed, 0x1407f);
  const Vec3 axis = random_vector(&faults).normalized();
  if (model_.mounting_error_deg > 0) {
    R_sensor_body_ = Eigen::AngleAxisd(model_.mounting_error_deg * std::numbers::pi / 180, axis).toRotationMatrix();
  }
  gyro_ramp_ = model_.gyro_bias_ramp * random_vector(&faults);
  accel_ramp_ = model_.accel_bias_ramp * random_vector(&faults);
}

void SimImu::filter_to(double t, Vec3* gyro, Vec3* accel) {
  const auto input = [&](double at) {
    const BodyState s = trajectory_.at(at);
    Eigen::Matrix<double, 6, 1> u;
    u << R_sensor_body_ * s.omega_rad_s, R_sensor_body_ * s.specific_force_m_s2;
    // What measures saturates before what filters.
    for (int i = 0; i < 3; ++i) {
      u[i] = std::clamp(u[i], -model_.gyro_range_rad_s, model_.gyro_range_rad_s);
      u[3 + i] = std::clamp(u[3 + i], -model_.accel_range_m_s2, model_.accel_range_m_s2);
    }
    return u;
  };
  const double tau = 0.5e-3 * model_.delay_ms;
  if (t_filtered_ < 0) {
    pole_[0] = pole_[1] = input(t);
  } else {
    const int steps = std::max(1, static_cast<int>(std::ceil((t - t_filtered_) / std::min(kFilterStepS, tau))));
    const double dt = (t - t_filtered_) / steps, keep = std::exp(-dt / tau);
    for (int i = 0; i < steps; ++i) {
      const Eigen::Matrix<double, 6, 1> before = pole_[0];
      pole_[0] = keep * pole_[0] + (1 - keep) * input(t_filtered_ + (i + 0.5) * dt);
      pole_[1] = keep * pole_[1] + (1 - keep) * 0.5 * (before + pole_[0]);
    }
  }
  t_filtered_ = t;
  *gyro = pole_[1].head<3>();
  *accel = pole_[1].tail<3>();
}

rt::TimeNs SimImu::told_time(double t) {
  if (model_.clock_jitter_ms <= 0) return start_ns_ + static_cast<rt::TimeNs>(std::llround(t * 1e9));
  const double limit = jitter_limit(model_.rate_hz);
  const double off = std::clamp(1e-3 * model_.clock_jitter_ms * clock_rng_.gaussian(), -limit, limit);
  return start_ns_ + static_cast<rt::TimeNs>(std::llround(std::max(0.0, t + off) * 1e9));
}

hal::ImuStatus SimImu::next(hal::ImuSample* sample, rt::TimeNs) {
  const double dt = 1.0 / model_.rate_hz, t = static_cast<double>(index_) * dt;
  if (t > trajectory_.duration_s()) return hal::ImuStatus::kEnd;
  const BodyState state = trajectory_.at(t);
  truth_.gyro_rad_s = state.omega_rad_s;
  truth_.accel_m_s2 = state.specific_force_m_s2;
  Vec3 seen_gyro = truth_.gyro_rad_s, seen_accel = truth_.accel_m_s2;
  if (model_.delay_ms > 0) {
    filter_to(t, &seen_gyro, &seen_accel);
  } else if (model_.mounting_error_deg > 0) {
    seen_gyro = R_sensor_body_ * seen_gyro;
    seen_accel = R_sensor_body_ * seen_accel;
  }
  // White noise of density n, sampled at rate f without a filter's correlation, has a standard deviation of n sqrt(f).
  const double root = model_.noise_times * std::sqrt(model_.rate_hz), walk = model_.noise_times * std::sqrt(dt);
  sample->t_ns = told_time(t);
  for (int i = 0; i < 3; ++i) {
    if (index_ > 0) {
      truth_.gyro_bias_rad_s[i] += model_.gyro_bias_walk * walk * rng_.gaussian() + gyro_ramp_[i] * dt;
      truth_.accel_bias_m_s2[i] += model_.accel_bias_walk * walk * rng_.gaussian() + accel_ramp_[i] * dt;
    }
    const double gyro = seen_gyro[i] + truth_.gyro_bias_rad_s[i] + model_.gyro_noise * root * rng_.gaussian();
    const double accel = seen_accel[i] + truth_.accel_bias_m_s2[i] + model_.accel_noise * root * rng_.gaussian();
    sample->gyro_rad_s[i] = measured(gyro, model_.gyro_range_rad_s, model_.quantise);
    sample->accel_m_s2[i] = measured(accel, model_.accel_range_m_s2, model_.quantise);
  }
  sample->flags = hal::saturated_flags(*sample, model_.gyro_range_rad_s, model_.accel_range_m_s2);
  ++index_;
  return hal::ImuStatus::kSample;
}

}  // namespace godwit::sim
