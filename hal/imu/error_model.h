// How an inertial sensor errs, as its data sheet, a calibration or a recording says it. Pure functions over text.
#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "hal/imu/imu.h"
#include "hal/rt/result.h"

namespace godwit::hal {

/// Each figure where somebody says it. Densities are those of Kalibr's noise model: of one axis, continuous in time.
struct ImuErrorModel {
  std::optional<double> gyroscope_noise_density;      ///< [rad/s/sqrt(Hz)]
  std::optional<double> gyroscope_random_walk;        ///< of the bias [rad/s^2/sqrt(Hz)]
  std::optional<double> accelerometer_noise_density;  ///< [m/s^2/sqrt(Hz)]
  std::optional<double> accelerometer_random_walk;    ///< of the bias [m/s^3/sqrt(Hz)]
  // What a calibration before take-off leaves, one sigma of an axis. Keys of our own. None of the gyroscope's bias:
  // vision sees that within a second.
  std::optional<double> accelerometer_bias_sigma;   ///< [m/s^2]
  std::optional<double> accelerometer_scale_sigma;  ///< a share of what is measured
  // Keys of our own, too: where its axes end. A reading there is a lower bound.
  std::optional<double> gyroscope_range;      ///< [rad/s]
  std::optional<double> accelerometer_range;  ///< [m/s^2]

  /// Nobody says anything.
  bool empty() const;
};

/// Reads the keys above out of Kalibr's imu.yaml or EuRoC's imu0/sensor.yaml; others are passed over. Error: no YAML, a
/// value that is no number, or one that no sensor has; with the file's name, the key and what is allowed.
rt::Result<ImuErrorModel> parse_imu_error_model(std::string_view text, const std::string& name);
/// Such a text of what a sensor says of itself, as far as it is a range that parse_imu_error_model takes; empty:
/// nothing.
std::string sensor_yaml(double rate_hz, const ImuRanges& ranges);
/// The same of a file, in which one key at least is wanted. Blocks.
rt::Result<ImuErrorModel> read_imu_error_model(const std::string& file);

}  // namespace godwit::hal
