// How ArduPilot's VISO_TYPE 3 takes ODOMETRY, by its behaviour: the position of every message is remembered, whatever
// its quality; when the reset counter changes, heading and position of the new measurement are aligned, the heading to
// the vehicle's, the position to what is remembered; arming compares the attitude of every message with the vehicle's.
#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <optional>

#include "firmware_app/link/mavlink/messages.h"

namespace godwit::link {

class VisoType3 {
 public:
  /// A message that came while the vehicle's own attitude was q_ned_body.
  void take(const mavlink::Odometry& m, const Eigen::Quaterniond& q_ned_body) {
    const Eigen::Vector3d position(m.x, m.y, m.z);
    const Eigen::Quaterniond q(m.q[0], m.q[1], m.q[2], m.q[3]);
    if (!reset_) {
      align_heading(q, q_ned_body);
    } else if (*reset_ != m.reset_counter) {
      ++resets;
      const Eigen::Vector3d before = last;
      align_heading(q, q_ned_body);
      correction_ = before - turn_ * position;
    }
    reset_ = m.reset_counter;
    last = turn_ * position + correction_;
    const Eigen::Quaterniond seen = turn_ * q;
    const double off = seen.angularDistance(q_ned_body);
    arming_refused = off > 10 * M_PI / 180;
    if (m.quality >= 0) fused = last;
  }

  Eigen::Vector3d last = Eigen::Vector3d::Zero();  ///< of the newest message, in the vehicle's frame
  std::optional<Eigen::Vector3d> fused;            ///< of the newest usable one
  bool arming_refused = false;
  int resets = 0;

 private:
  static double heading(const Eigen::Quaterniond& q) {
    const Eigen::Vector3d front = q * Eigen::Vector3d::UnitX();
    return std::atan2(front.y(), front.x());
  }
  void align_heading(const Eigen::Quaterniond& q, const Eigen::Quaterniond& vehicle) {
    turn_ = Eigen::AngleAxisd(heading(vehicle) - heading(q), Eigen::Vector3d::UnitZ());
  }

  std::optional<std::uint8_t> reset_;
  Eigen::Quaterniond turn_ = Eigen::Quaterniond::Identity();
  Eigen::Vector3d correction_ = Eigen::Vector3d::Zero();
};

}  // namespace godwit::link
