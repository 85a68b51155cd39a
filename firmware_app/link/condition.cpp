#include "firmware_app/link/condition.h"

#include <algorithm>

namespace godwit::link {

dronecan::NodeCondition condition(Reasons reasons, const NodeWishes& wishes) {
  using dronecan::NodeHealth;
  dronecan::NodeCondition c;
  c.reasons = reasons.bits();
  c.health = NodeHealth::kOk;
  for (const ReasonRow& row : kReasonTable) {
    if (reasons.has(row.reason)) c.health = std::max(c.health, row.health);
  }
  if (wishes.pose_wanted) c.health = std::max(c.health, NodeHealth::kWarning);
  if (wishes.imu_required && reasons.has(kImuFailed)) c.health = NodeHealth::kError;
  const bool works = wishes.any_pose || c.health == NodeHealth::kError;
  c.mode = works ? dronecan::NodeMode::kOperational : dronecan::NodeMode::kInitialization;
  return c;
}

}  // namespace godwit::link
