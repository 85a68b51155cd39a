// How the node is, as NodeStatus says it: a table from the reasons that hold to health, mode and vendor code.
#pragma once

#include <array>
#include <cstdint>

#include "firmware_app/link/dronecan_node.h"

namespace godwit::link {

/// Why the node is not well: bits of NodeStatus' vendor code.
enum Reason : std::uint16_t {
  kCameraFailed = 1U << 0,
  kImuFailed = 1U << 1,
  kProcessFailed = 1U << 2,
  kPoseStalled = 1U << 3,  ///< no new pose for PosePatience::silence_ns, or only stale ones
  kNoPose = 1U << 4,       ///< initialising, relocalising or lost
  kNoScale = 1U << 5,
  kNoGravity = 1U << 6,
  kTooHot = 1U << 7,
  kLatencyGrew = 1U << 8,
  kBusTrouble = 1U << 9,    ///< bus-off, gone, or messages dropped in the last second
  kNoAutopilot = 1U << 10,  ///< no HEARTBEAT for 3 s
  kNoTimesync = 1U << 11,
  kDetectorFailed = 1U << 12,
  kBadPose = 1U << 13,    ///< not finite, huge, or from the future: a fault of ours
  kSameNodeId = 1U << 14  ///< another node speaks under our id
};

/// What a reason alone makes of the health. Camera, process and bad poses make it; whether there is a pose is told by
/// state and quality, and enters only where the user wants arming to wait for one (NodeWishes::pose_wanted).
struct ReasonRow {
  Reason reason;
  dronecan::NodeHealth health;
};
inline constexpr std::array<ReasonRow, 15> kReasonTable{{
    {kCameraFailed, dronecan::NodeHealth::kError},
    {kImuFailed, dronecan::NodeHealth::kOk},  // an error where one is required (NodeWishes::imu_required)
    {kProcessFailed, dronecan::NodeHealth::kError},
    {kPoseStalled, dronecan::NodeHealth::kError},
    {kNoPose, dronecan::NodeHealth::kOk},
    {kNoScale, dronecan::NodeHealth::kOk},
    {kNoGravity, dronecan::NodeHealth::kOk},
    {kTooHot, dronecan::NodeHealth::kWarning},
    {kLatencyGrew, dronecan::NodeHealth::kOk},
    {kBusTrouble, dronecan::NodeHealth::kOk},
    {kNoAutopilot, dronecan::NodeHealth::kOk},
    {kNoTimesync, dronecan::NodeHealth::kOk},
    {kDetectorFailed, dronecan::NodeHealth::kOk},
    {kBadPose, dronecan::NodeHealth::kError},
    {kSameNodeId, dronecan::NodeHealth::kError},
}};

/// The reasons that hold at one moment.
class Reasons {
 public:
  void set(Reason reason, bool holds) {
    if (holds) bits_ = static_cast<std::uint16_t>(bits_ | reason);
  }
  bool has(Reason reason) const { return (bits_ & reason) != 0; }
  std::uint16_t bits() const { return bits_; }

 private:
  std::uint16_t bits_ = 0;
};

/// What besides the reasons decides.
struct NodeWishes {
  bool imu_required = false;
  bool pose_wanted = false;  ///< VIO_REQ_POSE, not armed, and the quality is below 0
  bool any_pose = false;     ///< a pose, usable or not, has come since the start
};

/// Pure.
dronecan::NodeCondition condition(Reasons reasons, const NodeWishes& wishes);

}  // namespace godwit::link
