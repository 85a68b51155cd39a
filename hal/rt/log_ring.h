// What a real-time thread has to say, without saying it itself: short entries through a ring to a thread that may wait.
#pragma once

#include <atomic>
#include <cstdint>

#include "hal/rt/spsc_ring.h"
#include "hal/rt/time.h"

namespace godwit::rt {

enum class LogLevel : std::uint8_t { kInfo, kWarning };

/// One event. Plain data; the words are static text, the numbers what was measured and its limit.
struct LogEntry {
  TimeNs t_ns = 0;
  LogLevel level = LogLevel::kInfo;
  const char* what = "";    ///< static text: what happened
  const char* which = "";   ///< static text: to which part, or what it is now; may be empty
  const char* why = "";     ///< static text: the reason; may be empty
  double value = 0;         ///< the figure behind the reason
  double limit = 0;         ///< 0: there is none
  const char* before = "";  ///< static text: what `which` was until now; may be empty
};

/// One writing thread, one reading thread. A full ring refuses and counts: a log that hangs holds nothing up.
class LogRing {
 public:
  /// Writer. No allocation, no lock, no wait.
  void say(const LogEntry& entry) {
    // Relaxed: a counter alone, nothing is ordered by it.
    if (!entries_.try_push(entry)) lost_.fetch_add(1, std::memory_order_relaxed);
  }
  /// Reader. False: there is nothing.
  bool take(LogEntry* entry) { return entries_.try_pop(entry); }
  /// Entries that found the ring full. Any thread.
  std::uint64_t lost() const { return lost_.load(std::memory_order_relaxed); }

 private:
  SpscRing<LogEntry, 256> entries_;
  std::atomic<std::uint64_t> lost_{0};
};

}  // namespace godwit::rt
