// How long the stress tests of the lock-free parts run.
#pragma once

#include <cstdint>
#include <cstdlib>

namespace godwit::test {

/// Items that pass between two threads: a million, or GODWIT_STRESS_ITEMS (100000000 before a release, under the thread
/// sanitizer as well).
inline std::uint64_t stress_items() {
  const char* const text = std::getenv("GODWIT_STRESS_ITEMS");
  return text != nullptr ? std::strtoull(text, nullptr, 10) : 1'000'000;
}

}  // namespace godwit::test
