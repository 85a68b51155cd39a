// How long the stress tests of the lock-free parts run. Ten to the eighth items each, under the thread sanitizer:
//   GODWIT_STRESS_ITEMS=100000000 sh -c 'for t in spsc_ring triple_buffer log_ring frame_pool; do
//     build/tsan/tests/rt/${t}_test --gtest_filter="*Stress*" || exit 1; done'
#pragma once

#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <thread>

namespace godwit::test {

/// Items that pass between two threads: a million, or GODWIT_STRESS_ITEMS (100000000 before a release).
inline std::uint64_t stress_items() {
  const char* const text = std::getenv("GODWIT_STRESS_ITEMS");
  return text != nullptr ? std::strtoull(text, nullptr, 10) : 1'000'000;
}

/// What a thread of a stress test does while the other side is not ready. A few empty rounds keep the two at each
/// other's heels; then it sleeps. Never yield(): on a busy machine that gives a whole time slice away, every few items.
class Patience {
 public:
  void progress() { empty_rounds_ = 0; }
  void wait() {
    if (++empty_rounds_ > kEmptyRounds) std::this_thread::sleep_for(std::chrono::microseconds(1));
  }

 private:
  static constexpr int kEmptyRounds = 100;
  int empty_rounds_ = 0;
};

}  // namespace godwit::test
