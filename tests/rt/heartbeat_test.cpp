#include "hal/rt/heartbeat.h"

#include <atomic>
#include <gtest/gtest.h>
#include <string>
#include <thread>

namespace godwit::rt {
namespace {

TEST(Heartbeats, TheOneLongestOverItsPatienceIsNamed) {
  Heartbeats all;
  const TimeNs before = monotonic_now_ns();
  Pulse quick = all.watch("quick", 100 * kNsPerMs);
  Pulse slow = all.watch("slow", kNsPerSecond);
  const TimeNs now = monotonic_now_ns();
  EXPECT_EQ(all.silent(now).name, nullptr);
  EXPECT_STREQ(all.silent(now + 200 * kNsPerMs).name, "quick");
  EXPECT_GE(all.silent(now + 200 * kNsPerMs).for_ns, 200 * kNsPerMs);
  EXPECT_LE(all.silent(now + 200 * kNsPerMs).for_ns, now - before + 200 * kNsPerMs);
  quick.end();
  EXPECT_EQ(all.silent(now + 200 * kNsPerMs).name, nullptr) << "it ended rightly";
  EXPECT_STREQ(all.silent(now + 2 * kNsPerSecond).name, "slow");
  slow.beat();
  quick.beat();
  EXPECT_EQ(all.silent(monotonic_now_ns()).name, nullptr);
}

TEST(Heartbeats, MoreThanThereIsRoomForAreNotWatchedAndAnEmptyPulseIsNobodys) {
  Heartbeats all;
  for (std::size_t i = 0; i < Heartbeats::kMost; ++i) all.watch("one", kNsPerSecond).end();
  Pulse late = all.watch("late", 1);
  late.beat();
  Pulse().end();
  EXPECT_EQ(all.silent(monotonic_now_ns() + 10 * kNsPerSecond).name, nullptr);
}

// For the thread sanitizer: threads that come, beat and go under somebody's eyes.
TEST(Heartbeats, BeatsAndLooksCross) {
  Heartbeats all;
  std::atomic<bool> end{false};
  std::thread looker([&] {
    while (!end.load()) {
      const Heartbeats::Silent s = all.silent(monotonic_now_ns());
      if (s.name != nullptr) {
        EXPECT_EQ(std::string(s.name), "beater");
      }
    }
  });
  for (int i = 0; i < 8; ++i) {
    Pulse pulse = all.watch("beater", kNsPerSecond);
    std::thread beater([pulse]() mutable {
      for (int k = 0; k < 1000; ++k) pulse.beat();
      pulse.end();
    });
    beater.join();
  }
  end.store(true);
  looker.join();
}

}  // namespace
}  // namespace godwit::rt
