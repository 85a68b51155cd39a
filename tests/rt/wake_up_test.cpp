#include "hal/rt/wake_up.h"

#include <gtest/gtest.h>
#include <thread>

namespace godwit::rt {
namespace {

TEST(WakeUp, EachPostLetsOneWaitThrough) {
  WakeUp wake;
  EXPECT_FALSE(wake.wait_for(0));
  wake.post();
  wake.post();
  EXPECT_TRUE(wake.wait_for(0));
  EXPECT_TRUE(wake.wait_for(kNsPerSecond));
  EXPECT_FALSE(wake.wait_for(kNsPerMs));
}

TEST(WakeUp, WakesASleepingThread) {
  WakeUp ping, pong;
  std::thread other([&] {
    for (int i = 0; i < 1000; ++i) {
      if (!ping.wait_for(60 * kNsPerSecond)) return;
      pong.post();
    }
  });
  int answered = 0;
  for (int i = 0; i < 1000; ++i) {
    ping.post();
    if (!pong.wait_for(60 * kNsPerSecond)) break;
    ++answered;
  }
  other.join();
  EXPECT_EQ(answered, 1000);
}

TEST(SleepUntil, ReturnsNotBeforeTheMoment) {
  const TimeNs until = monotonic_now_ns() + 2 * kNsPerMs;
  sleep_until_ns(until);
  EXPECT_GE(monotonic_now_ns(), until);
  sleep_until_ns(0);  // long past: returns
}

}  // namespace
}  // namespace godwit::rt
