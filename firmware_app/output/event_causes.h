// What makes the event recorder write: loss, reset, doubt, and somebody who asks.
#pragma once

#include <optional>
#include <string>

#include "firmware_app/pipeline/frame_record.h"

namespace godwit::app {

enum class EventKind : std::uint8_t { kLoss, kReset, kDoubt, kRequest };
constexpr std::size_t kEventKinds = 4;
/// As folders and files call it. Static text.
constexpr const char* event_kind_name(EventKind kind) {
  constexpr const char* kNames[] = {"loss", "reset", "doubt", "request"};
  return kNames[static_cast<std::size_t>(kind)];
}

struct EventCause {
  EventKind kind = EventKind::kRequest;
  rt::TimeNs t_ns = 0;  ///< capture time of the picture that showed it
  std::string reason;   ///< in words, with the figure and its limit
};

/// Looks at each frame that went through the tracker. One thread.
class EventCauses {
 public:
  /// Below this the self-check between vision and what measures beside it holds the pose for wrong: half way from "all
  /// fits" to the least (vo_core/inertial/self_check.h).
  static constexpr double kDoubt = 0.55;

  /// What this frame shows that the one before did not; a loss before a reset before doubt.
  std::optional<EventCause> look(const FrameRecord& r);

 private:
  vo::State state_ = vo::State::kInitialising;
  std::uint32_t map_id_ = 0, frame_id_ = 0;  ///< 0: none yet
  bool doubted_ = false;
};

}  // namespace godwit::app
