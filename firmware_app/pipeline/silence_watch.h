// When something that should come regularly has not come for too long, and when it is back. Pure logic.
#pragma once

#include <cstdint>
#include <optional>

#include "hal/rt/log_ring.h"
#include "hal/rt/time.h"

namespace godwit::app {

/// One thread; no allocation. All times of one clock.
class SilenceWatch {
 public:
  /// The words for the log, static text; silent is what was not heard for longer than limit_ns.
  SilenceWatch(const char* fell_silent, const char* heard_again, rt::TimeNs limit_ns)
      : fell_silent_(fell_silent), heard_again_(heard_again), limit_ns_(limit_ns) {}

  void heard(rt::TimeNs t_ns) { t_heard_ns_ = t_ns; }

  /// The entry if it fell silent or is heard again since the last look. What was never heard is missed from the first
  /// look on.
  std::optional<rt::LogEntry> look(rt::TimeNs now_ns) {
    if (!t_heard_ns_) t_heard_ns_ = now_ns;
    const rt::TimeNs age_ns = now_ns - *t_heard_ns_;
    const bool silent = age_ns > limit_ns_;
    if (silent == silent_) return std::nullopt;
    silent_ = silent;
    if (!silent) {
      return rt::LogEntry{now_ns, rt::LogLevel::kInfo, heard_again_,
                          "",     "after [s]",         rt::to_seconds(*t_heard_ns_ - t_lost_ns_)};
    }
    ++silences_;
    t_lost_ns_ = *t_heard_ns_;
    return rt::LogEntry{
        now_ns, rt::LogLevel::kWarning, fell_silent_, "", "for [s]", rt::to_seconds(age_ns), rt::to_seconds(limit_ns_)};
  }

  bool silent() const { return silent_; }               ///< at the last look
  std::uint64_t silences() const { return silences_; }  ///< how often it fell silent

 private:
  const char* const fell_silent_;
  const char* const heard_again_;
  const rt::TimeNs limit_ns_;
  std::optional<rt::TimeNs> t_heard_ns_;
  rt::TimeNs t_lost_ns_ = 0;  ///< when it was last heard before it fell silent
  bool silent_ = false;
  std::uint64_t silences_ = 0;
};

}  // namespace godwit::app
