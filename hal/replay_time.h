// Where a recording lies on the clock: one for all devices of it, so that their data fit together.
#pragma once

#include <atomic>
#include <limits>
#include <optional>

#include "hal/rt/time.h"

namespace godwit::hal {

/// The camera leads: it says when its first picture is captured, the others follow. All calls are wait-free.
class ReplayTime {
 public:
  /// The camera's thread, once: what was recorded at t_recorded_ns happens at t_clock_ns.
  void pin(rt::TimeNs t_recorded_ns, rt::TimeNs t_clock_ns) {
    first_ns_.store(t_recorded_ns, std::memory_order_relaxed);
    // Release, partner: the acquire load in offset_ns(). Otherwise another thread could see the offset and not yet the
    // first time.
    offset_ns_.store(t_clock_ns - t_recorded_ns, std::memory_order_release);
  }
  /// Any thread. What to add to a recorded time; nothing before the camera's first picture.
  std::optional<rt::TimeNs> offset_ns() const {
    const rt::TimeNs offset = offset_ns_.load(std::memory_order_acquire);
    return offset == kUnknown ? std::nullopt : std::optional<rt::TimeNs>(offset);
  }
  /// Any thread, after offset_ns() gave one: recorded time of the first picture.
  rt::TimeNs first_ns() const { return first_ns_.load(std::memory_order_relaxed); }

 private:
  static constexpr rt::TimeNs kUnknown = std::numeric_limits<rt::TimeNs>::min();
  std::atomic<rt::TimeNs> first_ns_{0};
  std::atomic<rt::TimeNs> offset_ns_{kUnknown};
};

}  // namespace godwit::hal
