// Rotation and time between a camera and an inertial sensor, from a flight that both saw: vision's turns against the
// gyroscope's.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "hal/imu/imu.h"
#include "hal/rt/result.h"
#include "hal/rt/time.h"

namespace godwit::app {

/// How the camera turned between two pictures, as vision saw it.
struct SeenTurn {
  rt::TimeNs t_from_ns = 0, t_to_ns = 0;  ///< on the camera's clock
  Eigen::Matrix3d R_from_to = Eigen::Matrix3d::Identity();
};

struct CameraImuFit {
  Eigen::Matrix3d R_body_cam = Eigen::Matrix3d::Identity();
  double time_offset_s = 0;  ///< a picture stamped t was taken at t + this on the sensor's clock
  Eigen::Vector3d gyro_bias_rad_s = Eigen::Vector3d::Zero();
  /// One sigma, of the rotation's worst axis and of the offset: neighbouring turns err together, by as much as what is
  /// left of them shows. 20 rendered flights scattered by 1.3 times these (docs/calibration.md).
  double turn_sigma_rad = 0, time_sigma_s = 0;
  double rms_rad = 0;              ///< what is left of a turn, an axis
  std::size_t turns = 0;           ///< that count
  std::size_t turns_left_out = 0;  ///< further off than their like, or where readings are missing
};

/// The largest time offset that is looked for.
constexpr double kMostTimeOffsetS = 0.1;

/// Needs no guess: for each of a row of offsets the rotation that fits all turns best is known in closed form; from the
/// best of them rotation, offset and bias together. Error: too few turns, or not about two axes at least, or none fits;
/// in words.
rt::Result<CameraImuFit> fit_camera_imu(const std::vector<SeenTurn>& turns,
                                        const std::vector<hal::ImuSample>& readings);

}  // namespace godwit::app
