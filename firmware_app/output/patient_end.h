// The end of a thread that may hang.
#pragma once

#include <atomic>
#include <functional>

#include "hal/rt/wake_up.h"

namespace godwit::app {

/// Waits for `ended`, which the thread sets when it has nothing left to do. After patience_ns calls abandon with its
/// name, which must not return; null: does not wait, since the join that follows does.
inline void await_end(const std::atomic<bool>& ended, const std::function<void(const char*)>& abandon,
                      const char* thread, rt::TimeNs patience_ns) {
  const rt::TimeNs give_up_ns = rt::monotonic_now_ns() + patience_ns;
  while (abandon && !ended.load(std::memory_order_acquire)) {
    if (rt::monotonic_now_ns() > give_up_ns) abandon(thread);
    rt::sleep_until_ns(rt::monotonic_now_ns() + rt::kNsPerMs);
  }
}

}  // namespace godwit::app
