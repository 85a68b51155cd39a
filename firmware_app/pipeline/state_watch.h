// Each change of the odometry's state as one entry for the log.
#pragma once

#include <optional>

#include "firmware_app/pipeline/frame_record.h"
#include "hal/rt/log_ring.h"

namespace godwit::app {

/// Tracker thread. No allocation.
class StateWatch {
 public:
  /// The entry for this frame if its state is not the last one's; the first state is told, too.
  std::optional<rt::LogEntry> changed(const FrameRecord& r) {
    if (r.state == state_) return std::nullopt;
    const bool well = r.state == vo::State::kTracking || !state_;
    const rt::LogEntry entry{.t_ns = r.t_capture_ns,
                             .level = well ? rt::LogLevel::kInfo : rt::LogLevel::kWarning,
                             .what = "state",
                             .which = vo::state_name(r.state),
                             .why = r.why.text,
                             .value = static_cast<double>(r.why.value),
                             .limit = static_cast<double>(r.why.limit),
                             .before = state_ ? vo::state_name(*state_) : ""};
    state_ = r.state;
    return entry;
  }

 private:
  std::optional<vo::State> state_;  ///< none yet
};

}  // namespace godwit::app
