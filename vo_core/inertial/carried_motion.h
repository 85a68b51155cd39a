// From the body's motion to the camera's, and on to a time at which nothing was seen.
#pragma once

#include "vo_core/inertial/dead_reckoning.h"
#include "vo_core/inertial/motion.h"

namespace godwit::vo {

/// How a camera that is carried by a body moves in a frame with z up, metres.
struct CameraMotion {
  SE3 T_nav_cam;
  Vec3 velocity_m_s = Vec3::Zero();  ///< along the frame's axes
  Vec3 rate_rad_s = Vec3::Zero();    ///< along the camera's axes
  /// Of (place [m], rotation vector [rad]) along the frame's axes: R_true = exp(e) R.
  Mat6 covariance = Mat6::Zero();
  Mat3 velocity_covariance = Mat3::Zero();
};

/// rate_rad_s: of the body, along its axes. No allocation.
CameraMotion camera_motion(const DeadReckoning& state, const CameraMounting& mounting, const Vec3& rate_rad_s);

/// The body's turn rate over the 10 ms before t_ns, on the sensor's clock; zero where nobody measured.
Vec3 body_rate(const ImuBuffer& readings, rt::TimeNs t_ns, const ImuBias& bias, const ImuNoise& noise);

/// And back again.
Motion motion_of(const DeadReckoning& state, const CameraMounting& mounting, rt::TimeNs t_sensor_ns);
DeadReckoning state_of(const Motion& motion);

/// The camera at t_ns >= from.t_sensor_ns, on the sensor's clock, by the readings. False, and *out untouched: nothing
/// is known to go on from, or nobody measured for longer than options.held_ns. No allocation.
bool carry(const Motion& from, rt::TimeNs t_ns, const ImuBuffer& readings, const DeadReckoningOptions& options,
           CameraMotion* out);

}  // namespace godwit::vo
