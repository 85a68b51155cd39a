// What is told of the detector: that masks come, that they fail, that it hangs. Pure logic.
#pragma once

#include <optional>

#include "firmware_app/pipeline/channels.h"
#include "hal/rt/log_ring.h"

namespace godwit::app {

/// Tracker thread; no allocation.
class DetectionWatch {
 public:
  /// real_pace: capture times are moments of this machine's clock.
  explicit DetectionWatch(bool real_pace) : real_pace_(real_pace) {}

  /// A detection came back. The entry if that is news.
  std::optional<rt::LogEntry> answered(const DetectionEnd& detection) {
    const Masks now = detection.failed ? Masks::kFailing : Masks::kComing;
    if (now == masks_) return std::nullopt;
    masks_ = now;
    if (detection.failed) return rt::LogEntry{detection.t_capture_ns, rt::LogLevel::kWarning, "detections fail"};
    // Without a pace the times of the pictures are not those of this machine.
    const double age_s = real_pace_ ? rt::to_seconds(detection.t_done_ns - detection.t_capture_ns) : 0;
    return rt::LogEntry{detection.t_capture_ns, rt::LogLevel::kInfo, "detections come", "", "after [s]", age_s};
  }

  /// It holds an order for too long, or no longer does; mask_age_ns: of the newest mask. The entry if that is news.
  std::optional<rt::LogEntry> stuck(bool stuck, rt::TimeNs t_ns, rt::TimeNs mask_age_ns) {
    if (stuck == stuck_) return std::nullopt;
    stuck_ = stuck;
    return rt::LogEntry{t_ns,
                        stuck ? rt::LogLevel::kWarning : rt::LogLevel::kInfo,
                        stuck ? "detector hangs" : "detector is back",
                        "",
                        "age of the mask [s]",
                        rt::to_seconds(mask_age_ns)};
  }

  /// Stuck, or without masks.
  bool failed() const { return stuck_ || masks_ == Masks::kFailing; }

 private:
  enum class Masks { kNone, kComing, kFailing };
  const bool real_pace_;
  Masks masks_ = Masks::kNone;
  bool stuck_ = false;
};

}  // namespace godwit::app
