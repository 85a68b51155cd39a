#include "firmware_app/output/event_causes.h"

#include <fmt/format.h>

namespace godwit::app {

std::optional<EventCause> EventCauses::look(const FrameRecord& r) {
  if (r.fate != FrameFate::kProcessed || r.repeated) return std::nullopt;
  const bool lost = state_ == vo::State::kTracking && r.state != vo::State::kTracking;
  const bool other_map = map_id_ != 0 && r.map_id != 0 && r.map_id != map_id_;
  const bool other_frame = r.metric && frame_id_ != 0 && r.frame_id != frame_id_;
  const bool doubted = r.metric && r.trust < kDoubt;
  const bool doubt_begins = doubted && !doubted_;
  const char* const before = vo::state_name(state_);
  const std::uint32_t map_before = map_id_, frame_before = frame_id_;
  state_ = r.state;
  if (r.map_id != 0) map_id_ = r.map_id;
  if (r.metric) {
    frame_id_ = r.frame_id;
    doubted_ = doubted;
  }
  if (lost) {
    return EventCause{EventKind::kLoss, r.t_capture_ns,
                      fmt::format("{} -> {}: {}", before, vo::state_name(r.state), r.reason.view())};
  }
  if (other_map) {
    return EventCause{EventKind::kReset, r.t_capture_ns, fmt::format("map {} -> {}", map_before, r.map_id)};
  }
  if (other_frame) {
    return EventCause{EventKind::kReset, r.t_capture_ns,
                      fmt::format("navigation frame {} -> {}", frame_before, r.frame_id)};
  }
  if (doubt_begins) {
    return EventCause{
        EventKind::kDoubt, r.t_capture_ns,
        fmt::format("vision and what measures beside it disagree: trust {:.2f}, limit {:.2f}", r.trust, kDoubt)};
  }
  return std::nullopt;
}

}  // namespace godwit::app
