// Each change of the odometry's state as one entry for the log.
#pragma once

#include <cstring>
#include <optional>

#include "firmware_app/pipeline/frame_record.h"
#include "hal/rt/log_ring.h"

namespace godwit::app {

/// Tracker thread. No allocation.
class StateWatch {
 public:
  /// The entry for this frame if its state is not the last one's; the first state is told, too.
  std::optional<rt::LogEntry> changed(const FrameRecord& r) {
    if (std::strcmp(r.state, state_) == 0) return std::nullopt;
    const bool well = std::strcmp(r.state, "TRACKING") == 0 || state_[0] == '\0';
    const rt::LogEntry entry{.t_ns = r.t_capture_ns,
                             .level = well ? rt::LogLevel::kInfo : rt::LogLevel::kWarning,
                             .what = "state",
                             .which = r.state,
                             .why = r.why.text,
                             .value = static_cast<double>(r.why.value),
                             .limit = static_cast<double>(r.why.limit),
                             .before = state_};
    state_ = r.state;
    return entry;
  }

 private:
  const char* state_ = "";  ///< static text
};

}  // namespace godwit::app
