// How long the stress tests of the lock-free parts run. Ten to the eighth items each, under the thread sanitizer:
//   GODWIT_STRESS_ITEMS=100000000 sh -c 'for t in spsc_ring triple_buffer log_ring frame_pool; do
//     build/tsan/tests/rt/${t}_test --gtest_filter="*Stress*" || exit 1; done'
#pragma once

#include <cstdint>
#include <cstdlib>

namespace godwit::test {

/// Items that pass between two threads: a million, or GODWIT_STRESS_ITEMS (100000000 before a release).
inline std::uint64_t stress_items() {
  const char* const text = std::getenv("GODWIT_STRESS_ITEMS");
  return text != nullptr ? std::strtoull(text, nullptr, 10) : 1'000'000;
}

}  // namespace godwit::test
