#include "hal/rt/time.h"

#include <ctime>

namespace godwit::rt {
namespace {
TimeNs read_clock(clockid_t id) {
  timespec ts{};
  clock_gettime(id, &ts);
  return static_cast<TimeNs>(ts.tv_sec) * kNsPerSecond + ts.tv_nsec;
}
}  // namespace

TimeNs monotonic_now_ns() {
  return read_clock(CLOCK_MONOTONIC);
}
TimeNs thread_cpu_now_ns() {
  return read_clock(CLOCK_THREAD_CPUTIME_ID);
}

}  // namespace godwit::rt
