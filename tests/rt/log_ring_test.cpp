#include "hal/rt/log_ring.h"

#include <gtest/gtest.h>
#include <memory>
#include <thread>

#include "tests/support/stress.h"

namespace godwit::rt {
namespace {

TEST(LogRing, KeepsTheOrderAndCountsWhatItCannotTake) {
  const auto ring = std::make_unique<LogRing>();
  for (int i = 0; i < 300; ++i) ring->say({i, LogLevel::kInfo, "step", "", "because", 1.5, 2.0});
  EXPECT_EQ(ring->lost(), 44u) << "the newest are refused: what led up to the trouble stays";
  LogEntry entry;
  for (int i = 0; i < 256; ++i) {
    ASSERT_TRUE(ring->take(&entry));
    EXPECT_EQ(entry.t_ns, i);
  }
  EXPECT_STREQ(entry.why, "because");
  EXPECT_FALSE(ring->take(&entry));
}

TEST(LogRingStress, OneThreadSaysAnotherTakes) {
  const auto kEntries = static_cast<std::int64_t>(test::stress_items());
  const auto ring = std::make_unique<LogRing>();
  std::thread writer([&] {
    for (std::int64_t i = 0; i < kEntries; ++i)
      ring->say({i, LogLevel::kWarning, "step", "", "", static_cast<double>(i), 0});
  });
  std::int64_t taken = 0;
  TimeNs last = -1;
  bool in_order = true;
  const auto take_all = [&] {
    LogEntry entry;
    while (ring->take(&entry)) {
      ++taken;
      in_order = in_order && entry.t_ns > last && entry.value == static_cast<double>(entry.t_ns);
      last = entry.t_ns;
    }
  };
  while (taken + static_cast<std::int64_t>(ring->lost()) < kEntries) take_all();
  writer.join();
  take_all();
  EXPECT_TRUE(in_order);
  EXPECT_EQ(taken + static_cast<std::int64_t>(ring->lost()), kEntries);
}

}  // namespace
}  // namespace godwit::rt
