// What the autopilot is told while there is no pose, and when it is told of a reset.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>

#include "firmware_app/link/odometry_message.h"
#include "hal/rt/time.h"

namespace godwit::link {

/// ArduPilot's VISO_TYPE 3 remembers the position of every message, whatever its quality, and when the reset counter
/// changes it aligns the new measurement to what it remembers. Its arming check compares the attitude of every message
/// with its own. So
/// - a message without a pose repeats the last position, at rest, with the sigma of what is not known;
/// - its attitude is one that agrees: the autopilot's own, turned by how far the two headings were apart when both were
///   known last; where gravity is known our own tilt with that heading; before the autopilot has told its attitude our
///   last one;
/// - a reset is told once, with the first usable pose that stands in another frame than the last usable one did;
/// - a pose found again in the same map after it jumped out of sight goes out once as unusable, so that what is
///   remembered is true before the reset aligns to it.
/// PX4 resets to the measurement and is served by the same. One thread; no allocation.
class PoseHold {
 public:
  PoseHold();
  /// The autopilot's attitude: body (front, right, down) to north, east, down. What is no rotation is passed over.
  void heard_attitude(const Eigen::Quaterniond& q_ned_body, rt::TimeNs now_ns);

  /// The newest sample's pose, and its map and jump counter. Returns by how much the reset counter of what is sent goes
  /// up with it.
  std::uint8_t take(const BodyPose& pose, std::uint32_t map_id, std::uint8_t jumps, rt::TimeNs now_ns);
  /// No sample came any more.
  void lose(rt::TimeNs now_ns);
  /// What is to be sent. quality -1 and metric false where it is no pose.
  const BodyPose& pose() const { return pose_; }
  /// pose() went out.
  void sent();

 private:
  BodyPose held(const BodyPose& pose, rt::TimeNs now_ns) const;
  bool knows_autopilot(rt::TimeNs now_ns) const;

  BodyPose pose_;
  Eigen::Vector3d last_position_ = Eigen::Vector3d::Zero();
  Eigen::Quaterniond last_q_ = Eigen::Quaterniond::Identity();
  Eigen::Quaterniond autopilot_q_ = Eigen::Quaterniond::Identity();
  rt::TimeNs t_autopilot_ns_ = 0;  ///< 0: never heard
  double heading_offset_ = 0;      ///< ours less the autopilot's, when both were known last [rad]
  bool any_usable_ = false;
  bool spoke_without_ = false;  ///< a message without a pose went out since the last usable one
  bool introducing_ = false;    ///< pose_ is true, and told as unusable before the reset
  std::uint32_t map_id_ = 0;    ///< of the last usable pose
  std::uint8_t jumps_ = 0;      ///< the same
};

}  // namespace godwit::link
