#include "firmware_app/pipeline/inertial_options.h"

#include <cmath>

namespace godwit::app {
namespace {

/// What a file says is of a sensor at rest, on a table, at one temperature. In flight it shakes, is late, a little
/// crooked and warms up. Measured with both on euroc_mh01 with the figures that EuRoC gives of its sensor (thirteen
/// starts: NEES 0.9 and 1.0; with its walks as they are, 1.0 and 1.6, the vertical twice as far off), and in the
/// simulator with a sensor that is twice as bad as is said of it (docs/inertial.md).
constexpr double kWhiteInFlight = 2, kWalkInFlight = 10;
/// How far its bias may be from what is said where it is asked whether a flight begins. Taken as it is said there, too,
/// a map of a flat pad that began wrong was believed a second too early (take-offs of scenario gnss-loss). Told with it
/// the vertical, and with it half of every place's variance, was that margin: a bias that nothing in a straight flight
/// shows (docs/inertial-design.md).
constexpr double kBeginBiasMargin = 2;

/// What vision's own scale may be off by where the sensor has no share in it. Simulator: 0.75 sigmas along the way with
/// none.
constexpr double kVisionScaleSigma = 2e-3;

void take(const std::optional<double>& said, double times, double* value) {
  if (said) *value = times * *said;
}

void take_densities(const hal::ImuErrorModel& errors, vo::ImuNoise* imu) {
  take(errors.gyroscope_noise_density, kWhiteInFlight, &imu->gyro);
  take(errors.accelerometer_noise_density, kWhiteInFlight, &imu->accel);
  take(errors.gyroscope_random_walk, kWalkInFlight, &imu->gyro_walk);
  take(errors.accelerometer_random_walk, kWalkInFlight, &imu->accel_walk);
}

}  // namespace

vo::InertialOdometryOptions inertial_options(const hal::ImuErrorModel& errors, rt::TimeNs readout_ns) {
  vo::InertialOdometryOptions out;
  out.readout_ns = readout_ns;
  take_densities(errors, &out.model.imu);
  // The gyroscope's bias keeps its wide prior: with a narrow one the turn that a map that began wrong makes was taken
  // for an absurd bias, and ended the window again and again.
  if (errors.accelerometer_bias_sigma) {
    out.prior.accel_bias_sigma = *errors.accelerometer_bias_sigma;
    out.begin_bias_margin = kBeginBiasMargin;
  }
  if (errors.accelerometer_scale_sigma)
    out.told_scale_sigma = std::hypot(kVisionScaleSigma, *errors.accelerometer_scale_sigma);
  return out;
}

vo::NavigationOptions navigation_options(const hal::ImuErrorModel& errors, rt::TimeNs coast_ns) {
  vo::NavigationOptions out;
  take_densities(errors, &out.inertial.imu);
  out.coast_ns = coast_ns;
  return out;
}

}  // namespace godwit::app
