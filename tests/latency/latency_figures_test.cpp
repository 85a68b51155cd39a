// Distributions, delays, ratios and what a thread used.
#include <atomic>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <thread>

#include "benchmarks/latency/compare.h"
#include "benchmarks/latency/figures.h"
#include "benchmarks/latency/thread_watch.h"
#include "hal/rt/time.h"
#include "hal/rt/wake_up.h"

namespace godwit::bench {
namespace {

TEST(Distribution, PercentilesOfAKnownRow) {
  std::vector<double> values;
  for (int i = 1000; i >= 0; --i) values.push_back(i);
  const Distribution d = distribution_of(values);
  EXPECT_EQ(d.samples, 1001u);
  EXPECT_DOUBLE_EQ(d.p50, 500);
  EXPECT_DOUBLE_EQ(d.p95, 950);
  EXPECT_DOUBLE_EQ(d.p99, 990);
  EXPECT_DOUBLE_EQ(d.p999, 999);
  EXPECT_DOUBLE_EQ(d.max, 1000);
  EXPECT_NEAR(d.mean, 500, 1e-9);
}

TEST(Distribution, OfNothingIsZero) {
  const Distribution d = distribution_of({});
  EXPECT_EQ(d.samples, 0u);
  EXPECT_EQ(d.max, 0);
}

TEST(CameraDelays, CountFromTheMiddleOfTheMiddleRow) {
  EXPECT_DOUBLE_EQ((CameraDelays{8, 15, 5}.delivery_ms()), 4 + 7.5 + 5);
  EXPECT_DOUBLE_EQ(CameraDelays{}.delivery_ms(), 0);
}

TEST(Ratio, IsTheMedianOfThePairs) {
  // The machine grew three times slower on the way; each pair saw the same machine.
  const Ratio r = ratio_of("x", {{1.1, 1}, {2.2, 2}, {3.3, 3}, {3, 3}, {3.6, 3}});
  EXPECT_DOUBLE_EQ(r.median, 1.1);
  EXPECT_DOUBLE_EQ(r.least, 1);
  EXPECT_DOUBLE_EQ(r.most, 1.2);
  EXPECT_LT(r.spread, 0.05);
}

TEST(Ratio, OfEqualPairsHasNoSpread) {
  const Ratio r = ratio_of("x", {{2, 2}, {3, 3}, {4, 4}});
  EXPECT_DOUBLE_EQ(r.median, 1);
  EXPECT_DOUBLE_EQ(r.spread, 0);
}

TEST(ThreadWatch, TellsABusyThreadFromASleepingOne) {
  std::atomic<bool> stop{false};
  std::thread busy([&] {
    pthread_setname_np(pthread_self(), "busy-one");
    while (!stop.load(std::memory_order_relaxed)) {
    }
  });
  std::thread idle([&] {
    pthread_setname_np(pthread_self(), "idle-one");
    while (!stop.load(std::memory_order_relaxed)) rt::sleep_until_ns(rt::monotonic_now_ns() + 5 * rt::kNsPerMs);
  });
  rt::sleep_until_ns(rt::monotonic_now_ns() + 50 * rt::kNsPerMs);
  ThreadWatch watch;
  watch.look(rt::monotonic_now_ns());
  rt::sleep_until_ns(rt::monotonic_now_ns() + 300 * rt::kNsPerMs);
  watch.look(rt::monotonic_now_ns());
  stop.store(true);
  busy.join();
  idle.join();
  const ThreadUse *busy_use = nullptr, *idle_use = nullptr;
  const auto uses = watch.uses();
  for (const ThreadUse& use : uses) {
    if (use.name == "busy-one") busy_use = &use;
    if (use.name == "idle-one") idle_use = &use;
  }
  ASSERT_NE(busy_use, nullptr);
  ASSERT_NE(idle_use, nullptr);
  EXPECT_GT(busy_use->cpu_percent, idle_use->cpu_percent);
  EXPECT_GT(idle_use->waits, 0u);
}

}  // namespace
}  // namespace godwit::bench
