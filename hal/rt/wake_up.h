// How a thread sleeps until another has work for it.
#pragma once

#include <semaphore.h>

#include "hal/rt/time.h"

namespace godwit::rt {

/// A counting wake-up call. Waiting is for the time between two frames only, never inside one. post() takes no lock and
/// enters the kernel only when somebody sleeps.
class WakeUp {
 public:
  WakeUp();
  ~WakeUp();
  WakeUp(const WakeUp&) = delete;
  WakeUp& operator=(const WakeUp&) = delete;

  /// Any thread. One post lets one wait through, now or later.
  void post();
  /// Waits for a post, at most timeout_ns (0 or less: looks only). False: the time passed.
  bool wait_for(TimeNs timeout_ns);

 private:
  sem_t semaphore_;
};

/// Sleeps until this moment of CLOCK_MONOTONIC; returns at once if it has passed.
void sleep_until_ns(TimeNs t_ns);

}  // namespace godwit::rt
