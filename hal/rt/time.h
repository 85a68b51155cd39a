// Time as the whole project counts it: CLOCK_MONOTONIC in nanoseconds.
#pragma once

#include <cstdint>

namespace godwit::rt {

/// Nanoseconds on CLOCK_MONOTONIC. Replay rebases its timestamps onto this clock.
using TimeNs = std::int64_t;

constexpr TimeNs kNsPerSecond = 1'000'000'000;
constexpr TimeNs kNsPerMs = 1'000'000;

constexpr double to_seconds(TimeNs t) {
  return static_cast<double>(t) * 1e-9;
}
constexpr double to_ms(TimeNs t) {
  return static_cast<double>(t) * 1e-6;
}

/// Now on CLOCK_MONOTONIC. No allocation, no lock, any thread.
TimeNs monotonic_now_ns();

/// Processor time used so far by the calling thread. No allocation, no lock.
TimeNs thread_cpu_now_ns();

}  // namespace godwit::rt
