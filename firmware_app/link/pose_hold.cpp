#include "firmware_app/link/pose_hold.h"

#include <algorithm>
#include <cmath>

namespace godwit::link {
namespace {

/// It is asked for ten times a second.
constexpr rt::TimeNs kAttitudeAgeNs = rt::kNsPerSecond;

double heading(const Eigen::Quaterniond& q) {
  const Eigen::Vector3d front = q * Eigen::Vector3d::UnitX();
  return std::atan2(front.y(), front.x());
}

Eigen::Quaterniond turned(double heading_rad, const Eigen::Quaterniond& q) {
  return Eigen::AngleAxisd(heading_rad, Eigen::Vector3d::UnitZ()) * q;
}

Eigen::Quaterniond rotation(const Eigen::Vector4d& wxyz) {
  return {wxyz(0), wxyz(1), wxyz(2), wxyz(3)};
}

BodyPose neutral() {
  return body_pose(PoseSample{}, OdometryConfig{});
}

}  // namespace

PoseHold::PoseHold() : pose_(neutral()) {}

void PoseHold::heard_attitude(const Eigen::Quaterniond& q_ned_body, rt::TimeNs now_ns) {
  if (!q_ned_body.coeffs().allFinite() || std::abs(q_ned_body.norm() - 1) > 0.1) return;
  autopilot_q_ = q_ned_body.normalized();
  t_autopilot_ns_ = now_ns;
}

bool PoseHold::knows_autopilot(rt::TimeNs now_ns) const {
  return t_autopilot_ns_ != 0 && now_ns - t_autopilot_ns_ <= kAttitudeAgeNs;
}

BodyPose PoseHold::held(const BodyPose& pose, rt::TimeNs now_ns) const {
  BodyPose out = pose;
  out.position = last_position_;
  Eigen::Quaterniond q = pose.attitude_known ? rotation(pose.q) : last_q_;
  if (knows_autopilot(now_ns)) {
    const Eigen::Quaterniond agreed = turned(heading_offset_, autopilot_q_);
    q = pose.attitude_known ? turned(heading(agreed) - heading(q), q) : agreed;
  }
  q.normalize();
  if (q.w() < 0) q.coeffs() = -q.coeffs();
  out.q << q.w(), q.x(), q.y(), q.z();
  return out;
}

std::uint8_t PoseHold::take(const BodyPose& pose, std::uint32_t map_id, std::uint8_t jumps, rt::TimeNs now_ns) {
  if (pose.quality < 0) {
    introducing_ = false;
    pose_ = held(pose, now_ns);
    return 0;
  }
  pose_ = pose;
  last_position_ = pose.position;
  last_q_ = rotation(pose.q);
  if (knows_autopilot(now_ns)) heading_offset_ = heading(last_q_) - heading(autopilot_q_);
  const auto jumped = static_cast<std::uint8_t>(jumps - jumps_);
  std::uint8_t steps = jumped;
  if (!any_usable_) {
    // What was said before was no place in this frame.
    steps = spoke_without_ ? 1 : 0;
  } else if (map_id != map_id_) {
    steps = std::max<std::uint8_t>(1, jumped);
  } else if (jumped != 0 && spoke_without_) {
    introducing_ = true;
    pose_.quality = -1;
    return 0;
  }
  any_usable_ = true;
  spoke_without_ = introducing_ = false;
  map_id_ = map_id;
  jumps_ = jumps;
  return steps;
}

void PoseHold::lose(rt::TimeNs now_ns) {
  introducing_ = false;
  pose_ = held(neutral(), now_ns);
}

void PoseHold::sent() {
  // An introduction that went out has done what it was for.
  if (pose_.quality < 0) spoke_without_ = !introducing_;
}

}  // namespace godwit::link
