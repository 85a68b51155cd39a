// MAVLink ODOMETRY from a pose: from the camera through the mounting to the body, in the frames of an autopilot
// profile.
#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "firmware_app/link/mavlink/messages.h"
#include "firmware_app/link/pose_sample.h"

namespace godwit::link {

/// Which frames an autopilot takes. ArduPilot drops everything but LOCAL_FRD/BODY_FRD in silence; PX4 cannot arm on
/// LOCAL_FRD without a magnetometer.
enum class Profile : std::uint8_t { kArdupilot = 0, kPx4 = 1 };

constexpr std::uint8_t kFrameLocalNed = 1;
constexpr std::uint8_t kFrameBodyFrd = 12;
constexpr std::uint8_t kFrameLocalFrd = 20;

struct OdometryConfig {
  Profile profile = Profile::kArdupilot;
  /// Mounting: p_body = R_body_cam * p_cam + t_body_cam; body is front-right-down. Default: looking ahead.
  Eigen::Matrix3d R_body_cam{{0, 0, 1}, {1, 0, 0}, {0, 1, 0}};
  Eigen::Vector3d t_body_cam = Eigen::Vector3d::Zero();
  /// Heading of the world's x axis, clockwise from north [rad]; for the px4 profile, whose frame points north.
  double world_heading_rad = 0;
  /// Where a sample knows its heading the frame points north, whatever the profile and the one above.
  bool north = true;
  bool inertial = false;  ///< an IMU takes part: estimator type VIO instead of VISION
  /// Replay only: take scale and gravity as known. Where the scale is not, t_body_cam is left out: it is in metres.
  bool bench_metric = false;
};

/// Pose in the profile's frames, before it becomes a message; also what the telemetry frames carry. Always finite.
struct BodyPose {
  bool attitude_known = false;  ///< else the attitude is neutral
  bool metric = false;          ///< else velocity is zero, quality -1, and the position is none of it
  std::int8_t quality = -1;     ///< -1 failed, 1 to 100
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  ///< [m], local frame
  Eigen::Vector4d q{1, 0, 0, 0};                       ///< w x y z, body to local frame, w >= 0
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();  ///< [m/s], body axes
  Eigen::Vector3d rates = Eigen::Vector3d::Zero();     ///< [rad/s], body axes
  Eigen::Matrix<double, 6, 6> covariance;              ///< position and rotation vector, local axes
  Eigen::Matrix3d velocity_covariance;                 ///< body axes
};

/// Largest variances that are sent, and those of what is not known: 100 m, 100 m/s, pi.
constexpr double kUnknownPositionVariance = 1e4;
constexpr double kUnknownAngleVariance = 9.87;

/// Carries a pose to the body. Not finite, huge (above 100 km or 300 m/s) or stateless poses come out with quality -1
/// and neutral fields, with a sigma nobody would fuse (100 m); PoseHold makes of them what is sent. No allocation.
BodyPose body_pose(const PoseSample& sample, const OdometryConfig& config);

/// 1 to 100 for a usable pose: 100 / (1 + (position / 3 m)^2 + (angle / 5 deg)^2 + (velocity / 0.5 m/s)^2) of the
/// sigmas of an axis (root mean square of the three), times the sample's trust, half of it while coasting. It falls as
/// any variance grows (docs/navigation.md).
std::int8_t pose_quality(const PoseSample& sample, const OdometryConfig& config = {});

/// The message. time_usec is the capture time on our clock; the autopilot maps it by TIMESYNC or by the smallest delay.
mavlink::Odometry odometry_message(const BodyPose& pose, const OdometryConfig& config, rt::TimeNs t_capture_ns,
                                   std::uint8_t reset_counter);

}  // namespace godwit::link
