// Distributions, delays, ratios and what a thread used.
#include <atomic>
#include <cmath>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <random>
#include <string>
#include <thread>
#include <utility>
#include <vector>

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

TEST(Ratio, IsInTheMiddleOfThePairs) {
  // The machine grew three times slower on the way; each pair saw the same machine.
  const Ratio r =
      ratio_of("x", {{1.1, 1, true}, {2.2, 2, false}, {3.3, 3, true}, {3, 3, false}, {3.6, 3, true}, {3.3, 3, false}});
  EXPECT_DOUBLE_EQ(r.median, 1.1);
  EXPECT_DOUBLE_EQ(r.least, 1);
  EXPECT_DOUBLE_EQ(r.most, 1.2);
  EXPECT_LT(r.spread, 0.05);
  EXPECT_GT(r.spread, 0.01);
  EXPECT_EQ(r.pairs, 6u);
}

TEST(Ratio, OfEqualPairsHasNoSpread) {
  const Ratio r = ratio_of("x", {{2, 2, true}, {3, 3, false}, {4, 4, true}});
  EXPECT_DOUBLE_EQ(r.median, 1);
  EXPECT_DOUBLE_EQ(r.spread, 0);
}

TEST(Ratio, WhatBeingFirstCostsGoesOut) {
  std::vector<Pair> pairs;
  pairs.reserve(9);
  for (int i = 0; i < 9; ++i) pairs.push_back(i % 2 == 0 ? Pair{2.2, 1, true} : Pair{2, 1.1, false});
  const Ratio r = ratio_of("x", pairs);  // the median over the pairs would be 2.2
  EXPECT_NEAR(r.median, 2, 1e-12);
  EXPECT_NEAR(r.spread, 0, 1e-12);
}

TEST(Ratio, TurnedRoundIsTheInverse) {
  std::vector<Pair> pairs, turned;
  std::mt19937 random(1);
  std::lognormal_distribution<double> figure(0, 0.2);
  pairs.reserve(10);
  turned.reserve(10);
  for (int i = 0; i < 10; ++i) pairs.push_back({figure(random), figure(random), i % 2 == 0});
  for (const Pair& p : pairs) turned.push_back({p.b, p.a, !p.a_first});
  EXPECT_NEAR(ratio_of("x", pairs).median * ratio_of("x", turned).median, 1, 1e-12);
}

TEST(Ratio, APairGoneWrongMovesItLittle) {
  std::vector<Pair> pairs;
  pairs.reserve(12);
  for (int i = 0; i < 12; ++i) pairs.push_back({1 + 0.004 * i, 1 + 0.004 * (11 - i), i % 2 == 0});
  pairs[3].a = 5;  // another program came in between
  EXPECT_NEAR(ratio_of("x", pairs).median, 1, 0.02);
}

// A program with itself: flights that scatter by 4 % each, the first of a pair 3 % dearer, one in ten half as dear
// again.
TEST(Ratio, SpreadIsHowFarItWanders) {
  std::mt19937 random(1);
  std::normal_distribution<double> noise(0, 0.04);
  std::bernoulli_distribution spoilt(0.1);
  const auto flight = [&](bool first) {
    return std::exp(noise(random) + (first ? 0.03 : 0)) * (spoilt(random) ? 1.5 : 1);
  };
  constexpr int kRuns = 500;
  double squares = 0;
  int within = 0;
  for (int run = 0; run < kRuns; ++run) {
    std::vector<Pair> pairs;
    pairs.reserve(20);
    for (int i = 0; i < 20; ++i) {
      const bool a_first = i % 2 == 0;
      const double a = flight(a_first), b = flight(!a_first);
      pairs.push_back({a, b, a_first});
    }
    const Ratio r = ratio_of("x", pairs);
    squares += (r.median - 1) * (r.median - 1);
    within += std::abs(r.median - 1) <= 2 * r.spread ? 1 : 0;
  }
  EXPECT_LT(std::sqrt(squares / kRuns), 0.03);
  EXPECT_GT(within, 0.9 * kRuns);
}

/// The figures of a flight of 100 pictures in 10 s: full and small detections, others [% of a processor], and what a
/// detection of full input costs (a small one a half) [ms].
std::string flight(int full, int small, double others_percent, double detection_ms) {
  const auto detector_percent = (full * detection_ms + small * detection_ms / 2) / 100;
  return fmt::format(
      R"({{"kind": "latency", "flights": [{{"detector": true, "seconds": 10, "frames": {{"processed": 100}},
           "tracker_cpu_ms": {{"median": 1, "p99": 2}}, "own_at_pose_ms": {{"median": 1}},
           "detections": {{"done": {}}},
           "detection_cpu_ms": {{"full": {{"samples": {}, "median": {}}}, "small": {{"samples": {}, "median": {}}}}},
           "threads": [{{"name": "gw-tracker", "cpu_percent": {}}}, {{"name": "gw-detector", "cpu_percent": {}}}]}}]}})",
      full + small, full, detection_ms, small, detection_ms / 2, others_percent, detector_percent);
}
constexpr const char* kAll = "detector on: CPU time of all threads, as many detections";
constexpr const char* kFull = "detector on: a detection's CPU time, full input, median";

TEST(PairFigures, HowManyDetectionsAFlightHadCostsNothing) {
  const auto figures = pair_figures(flight(80, 0, 5, 50), flight(28, 40, 5, 50));
  ASSERT_TRUE(figures.ok()) << figures.error().message;
  const auto [a, b] = figures.value().at(kAll);
  EXPECT_DOUBLE_EQ(a, b);
  EXPECT_DOUBLE_EQ(a, 5 + 0.54 * 50) << "5 ms a picture, and 54 detections in 100 pictures";
  EXPECT_EQ(figures.value().count("detector on: a detection's CPU time, small input, median"), 0u);
  EXPECT_EQ(figures.value().at("detector on: detections a second"), (std::pair{8.0, 6.8}));
}

TEST(PairFigures, WhatADetectionCostsDoes) {
  const auto figures = pair_figures(flight(80, 10, 5, 60), flight(60, 20, 5, 50));
  ASSERT_TRUE(figures.ok());
  EXPECT_EQ(figures.value().at(kFull), (std::pair{60.0, 50.0}));
  const auto [a, b] = figures.value().at(kAll);
  EXPECT_DOUBLE_EQ(a, 5 + 0.7 * 60 + 0.15 * 30);
  EXPECT_DOUBLE_EQ(b, 5 + 0.7 * 50 + 0.15 * 25);
}

TEST(PairFigures, WhatOneSideDidNotDoIsLeftOut) {
  const auto figures = pair_figures(flight(80, 0, 5, 50), flight(4, 60, 5, 50));
  ASSERT_TRUE(figures.ok());
  EXPECT_EQ(figures.value().count(kFull), 0u) << "four are too few";
  EXPECT_EQ(figures.value().count(kAll), 0u) << "without the detector it would not be all threads";
  EXPECT_EQ(figures.value().count("detector on: tracker CPU time, median"), 1u);
  ASSERT_TRUE(pair_figures(flight(80, 0, 5, 50), flight(0, 0, 5, 50)).ok()) << "all shed";
}

TEST(PairFigures, OtherFlightsAndOtherFilesAreRefused) {
  const std::string one = flight(80, 0, 5, 50);
  EXPECT_FALSE(pair_figures(one, "{").ok());
  EXPECT_FALSE(pair_figures(one, R"({"kind": "latency", "flights": []})").ok());
  EXPECT_FALSE(pair_figures(one, R"({"kind": "latency", "flights": [{"detector": true}]})").ok());
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
