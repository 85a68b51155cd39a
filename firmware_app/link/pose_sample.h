// What the odometry tells the autopilot link: state, pose, covariance and quality of one frame leave together.
#pragma once

#include <array>
#include <cstdint>

#include "hal/rt/time.h"
#include "vo_core/inertial/motion.h"
#include "vo_core/tracking/state.h"

namespace godwit::link {

using PoseState = vo::State;

/// One frame's pose. Plain bytes, so that it travels through rt::TripleBuffer.
///
/// World: right-handed, origin where the map began, z up once gravity is known, x a fixed horizontal direction.
/// Camera: x right, y down, z forward. Everything metric once has_scale.
struct PoseSample {
  rt::TimeNs t_capture_ns = 0;    ///< middle of exposure, CLOCK_MONOTONIC
  rt::TimeNs t_published_ns = 0;  ///< when it was given to the link; 0: not known
  PoseState state = PoseState::kInitialising;
  bool has_scale = false;
  bool has_gravity = false;
  bool has_velocity = true;        ///< false: the pose stands alone, nobody knows yet how it moves
  std::uint8_t reset_counter = 0;  ///< counts the jumps of the pose in this run; any change is passed on
  std::uint32_t map_id = 0;        ///< poses of one number stand in one frame; another one is a reset
  std::uint16_t measurements = 0;  ///< image measurements that updated this pose
  double trust = 1;                ///< 0 to 1: whether what measures it agrees over time
  /// Of the world's x axis, clockwise from north [rad]; the pose and its covariance are along the world's axes all the
  /// same. The frame that is sent is turned to it about north_about, so that no place jumps there: turned about its
  /// origin it is then moved by north_moved, along north and west [m].
  bool heading_known = false;
  /// The variance is of the camera's heading from north, all that vision strayed by in it: not to be added to the
  /// covariance's, which is of the heading from where the frame began.
  double heading_rad = 0, heading_variance = 0;
  std::array<double, 2> north_about{}, north_moved{};

  std::array<double, 3> position{};               ///< of the camera in the world [m]
  std::array<double, 4> orientation{1, 0, 0, 0};  ///< w x y z, camera to world
  std::array<double, 3> velocity{};               ///< of the camera, along world axes [m/s]
  std::array<double, 3> angular_velocity{};       ///< of the camera, along camera axes [rad/s]
  /// Of (position [m], orientation [rad]), rows first. The orientation's error is a rotation vector along world axes:
  /// R_true = exp(e) R.
  std::array<double, 36> covariance{};
  std::array<double, 9> velocity_covariance{};  ///< along world axes [m^2/s^2], rows first
  vo::Motion motion;  ///< of the body in the same world, to go on from; has_scale and has_gravity only
};

/// How the machine is. Written by whoever watches camera, IMU and threads.
struct SystemHealth {
  bool camera_ok = true;  ///< pictures come
  bool imu_ok = true;
  bool process_ok = true;   ///< threads alive, no page faults or slips out of bounds
  bool detector_ok = true;  ///< its absence is a warning, no failure
  float temperature_c = 0;
  bool throttled = false;  ///< the machine slows its processors down
  bool operator==(const SystemHealth&) const = default;
};

}  // namespace godwit::link
