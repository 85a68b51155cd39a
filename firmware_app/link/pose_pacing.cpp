#include "firmware_app/link/pose_pacing.h"

namespace godwit::link {

bool PosePacing::due(rt::TimeNs t_capture_ns, rt::TimeNs period_ns) {
  if (t_capture_ns < t_next_due_ns_ - period_ns / 4) return false;
  t_next_due_ns_ += period_ns;
  // After a gap the plan begins anew.
  if (t_capture_ns > t_next_due_ns_) t_next_due_ns_ = t_capture_ns + period_ns;
  return true;
}

}  // namespace godwit::link
