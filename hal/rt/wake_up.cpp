#include "hal/rt/wake_up.h"

#include <cassert>
#include <cerrno>
#include <ctime>

namespace godwit::rt {
namespace {
timespec to_timespec(TimeNs t_ns) {
  timespec ts{};
  ts.tv_sec = static_cast<time_t>(t_ns / kNsPerSecond);
  ts.tv_nsec = static_cast<long>(t_ns % kNsPerSecond);
  return ts;
}
}  // namespace

WakeUp::WakeUp() {
  [[maybe_unused]] const int failed = sem_init(&semaphore_, 0, 0);
  assert(failed == 0);
}

WakeUp::~WakeUp() {
  sem_destroy(&semaphore_);
}

void WakeUp::post() {
  sem_post(&semaphore_);
}

bool WakeUp::wait_for(TimeNs timeout_ns) {
  if (timeout_ns <= 0) return sem_trywait(&semaphore_) == 0;
  const timespec until = to_timespec(monotonic_now_ns() + timeout_ns);
  // sem_clockwait: sem_timedwait would count on CLOCK_REALTIME, which jumps when the clock is set.
  while (sem_clockwait(&semaphore_, CLOCK_MONOTONIC, &until) != 0) {
    if (errno != EINTR) return false;
  }
  return true;
}

void sleep_until_ns(TimeNs t_ns) {
  if (t_ns <= 0) return;
  const timespec until = to_timespec(t_ns);
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) {
  }
}

}  // namespace godwit::rt
