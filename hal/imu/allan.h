// Allan deviation of a still inertial sensor, and the noise figures that follow from it (IEEE Std 952-1997, annex C).
#pragma once

#include <array>
#include <string>
#include <vector>

#include "hal/imu/imu.h"
#include "hal/rt/result.h"

namespace godwit::hal {

struct AllanPoint {
  double tau_s = 0;
  double deviation = 0;    ///< of the means over tau_s, in the signal's unit
  double independent = 0;  ///< how many spans of tau_s the recording holds: what the deviation rests on
};

/// Overlapping Allan deviation of evenly sampled values at about 8 spans a factor of ten, from one step to a ninth of
/// the recording.
std::vector<AllanPoint> allan_deviation(const std::vector<double>& values, double step_s);

/// White noise density N [unit/sqrt(Hz)], bias instability B [unit] and random walk K [unit/s/sqrt(Hz)] of
/// sigma^2(tau) = N^2 / tau + (2 ln 2 / pi) B^2 + K^2 tau / 3, fitted with non-negative terms, each point weighed by
/// what it rests on.
struct NoiseFigures {
  double density = 0, bias_instability = 0, random_walk = 0;
};
NoiseFigures fit_noise(const std::vector<AllanPoint>& points);

/// Both sensors' axes.
struct ImuNoise {
  double rate_hz = 0, seconds = 0;
  std::array<std::vector<AllanPoint>, 6> points;  ///< gyro x y z [rad/s], acceleration x y z [m/s^2]
  std::array<NoiseFigures, 6> axis;
  NoiseFigures gyro, accel;  ///< the worst axis, figure by figure
};

/// Error: too short (a hundred seconds), with too many samples missing, or not still: a figure would be one of the
/// movement.
rt::Result<ImuNoise> analyse_still(const std::vector<ImuSample>& samples);

/// Kalibr's imu.yaml, with our bias instabilities as comments.
std::string imu_yaml(const ImuNoise& noise);

}  // namespace godwit::hal
