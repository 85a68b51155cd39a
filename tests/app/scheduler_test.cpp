// The scheduler through hours of flight in milliseconds, with cost traces of good and bad detectors and machines.
#include "firmware_app/scheduler/scheduler.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <gtest/gtest.h>
#include <limits>
#include <random>
#include <vector>

namespace godwit::app {
namespace scheduler_test {

constexpr rt::TimeNs kFrame = 33'333'333;
constexpr rt::TimeNs kMs = rt::kNsPerMs;
constexpr rt::TimeNs kMinute = 60 * rt::kNsPerSecond;

/// A flight: frames at 30 a second, a tracker and a detector that cost what the test says.
struct Flown {
  explicit Flown(const SchedulerOptions& options) : scheduler(options) {}

  Scheduler scheduler;
  rt::TimeNs now = rt::kNsPerSecond;
  std::vector<RungChange> changes;
  rt::TimeNs oldest_mask = 0;
  int frames = 0, detector_frames = 0;
  int keyframe_every = 15;

  /// What a frame costs on this rung, and how long a detection with this input takes; negative: it never ends.
  std::function<rt::TimeNs(const SchedulePlan&)> tracker = [](const SchedulePlan&) { return 4 * kMs; };
  std::function<rt::TimeNs(int)> detector = [](int) { return 40 * kMs; };

  void fly(rt::TimeNs duration) {
    for (const rt::TimeNs end = now + duration; now < end; now += kFrame) {
      ++frames;
      if (busy && done_at <= now) {
        busy = false;
        scheduler.detection_done(done_at, t_picture, false);
      }
      const rt::TimeNs cost = tracker(scheduler.plan());
      if (const auto c = scheduler.frame_done(now + cost, cost, cost + kMs / 2, cost > kFrame ? 1 : 0))
        changes.push_back(*c);
      if (const auto o = scheduler.order(now + cost, frames % keyframe_every == 0)) {
        EXPECT_FALSE(busy) << "one detection at a time";
        busy = true;
        t_picture = now;
        const rt::TimeNs takes = detector(o->input_px);
        done_at = takes < 0 ? std::numeric_limits<rt::TimeNs>::max() : now + cost + takes;
      }
      detector_frames += busy ? 1 : 0;
      oldest_mask = std::max(oldest_mask, scheduler.mask_age_ns(now));
    }
  }
  Rung rung() const { return scheduler.plan().rung; }

  bool busy = false;
  rt::TimeNs done_at = 0, t_picture = 0;
};

SchedulerOptions with_detector() {
  SchedulerOptions o;
  o.detector = true;
  return o;
}

TEST(Scheduler, AFastDetectorKeepsEverythingForHours) {
  Flown f(with_detector());
  f.fly(180 * kMinute);
  EXPECT_TRUE(f.changes.empty());
  EXPECT_EQ(f.scheduler.counters().slips, 0u);
  EXPECT_EQ(f.scheduler.plan().input_px, 416);
  EXPECT_LT(f.oldest_mask, 400 * kMs);
  // Every third frame, and keyframes.
  EXPECT_NEAR(static_cast<double>(f.scheduler.counters().detections) / f.frames, 1 / 3.0, 0.04);
}

TEST(Scheduler, AnUnevenCameraDoesNotStretchTheDetectorsPeriod) {
  // Frames come up to 3 ms early or late: every third is still the one that is looked at.
  Scheduler scheduler(with_detector());
  std::mt19937 random(1);
  std::uniform_int_distribution<rt::TimeNs> jitter(-3 * kMs, 3 * kMs);
  int detections = 0;
  constexpr int kFrames = 3000;
  for (int i = 0; i < kFrames; ++i) {
    const rt::TimeNs now = rt::kNsPerSecond + i * kFrame + jitter(random);
    scheduler.frame_done(now, 4 * kMs, 5 * kMs, 0);
    if (!scheduler.order(now, false)) continue;
    ++detections;
    scheduler.detection_done(now + 20 * kMs, now, false);
  }
  EXPECT_NEAR(detections, kFrames / 3.0, kFrames / 100.0);
}

TEST(Scheduler, ASlowDetectorGetsTheSmallInputForTheMasksSake) {
  Flown f(with_detector());
  f.detector = [](int px) { return static_cast<rt::TimeNs>(220.0 * kMs * px * px / (416 * 416)); };
  f.fly(10 * kMinute);
  EXPECT_TRUE(f.changes.empty()) << "the tracker does not suffer, so no rung is lost";
  EXPECT_EQ(f.scheduler.plan().input_px, 320);
  EXPECT_LT(f.scheduler.mask_age_ns(f.now), 400 * kMs);
  EXPECT_GT(f.scheduler.plan().period_ns, 3 * kFrame) << "it pauses between two detections";
  // A faster machine, and the large input is back.
  f.detector = [](int) { return 30 * kMs; };
  f.fly(kMinute);
  EXPECT_EQ(f.scheduler.plan().input_px, 416);
}

TEST(Scheduler, KeyframesOneAfterTheOtherLeaveTheMapperItsTime) {
  Flown f(with_detector());
  f.keyframe_every = 1;
  f.detector = [](int) { return 150 * kMs; };
  f.fly(kMinute);
  EXPECT_GT(f.detector_frames, f.frames * 6 / 10) << "the period is not waited for";
  EXPECT_LT(f.detector_frames, f.frames * 85 / 100) << "a fifth of the time is";
}

TEST(Scheduler, OnTheRungOfTheLongPeriodKeyframesDoNotMakeItShort) {
  Flown f(with_detector());
  f.keyframe_every = 1;
  f.detector = [](int) { return 20 * kMs; };
  f.scheduler.machine(90, false);
  for (int s = 0; s < 20 && f.rung() < Rung::kLongPeriod; ++s) f.fly(rt::kNsPerSecond);
  ASSERT_EQ(f.rung(), Rung::kLongPeriod);
  f.frames = f.detector_frames = 0;
  f.fly(rt::kNsPerSecond);
  EXPECT_GT(f.detector_frames, 5);
  EXPECT_LT(f.detector_frames, f.frames * 4 / 10);
}

TEST(Scheduler, ANoisyDetectorSwingsNothing) {
  Flown f(with_detector());
  std::mt19937 random(1);
  std::lognormal_distribution<double> takes(std::log(45.0), 0.6);
  f.detector = [&](int) { return static_cast<rt::TimeNs>(takes(random) * kMs); };
  int sizes = 0, last = 0;
  for (int minute = 0; minute < 120; ++minute) {
    f.fly(kMinute);
    sizes += f.scheduler.plan().input_px != last ? 1 : 0;
    last = f.scheduler.plan().input_px;
  }
  EXPECT_TRUE(f.changes.empty());
  EXPECT_LE(sizes, 3);
}

TEST(Scheduler, AStuckDetectorIsGivenUpOnAndTakenBackWhenItReturns) {
  Flown f(with_detector());
  f.fly(kMinute);
  f.detector = [](int) { return rt::TimeNs{-1}; };
  f.fly(10 * rt::kNsPerSecond);
  EXPECT_TRUE(f.scheduler.detector_stuck());
  EXPECT_FALSE(f.scheduler.plan().detector_on);
  EXPECT_EQ(f.scheduler.counters().detector_stuck, 1u) << "once, not once a frame";
  EXPECT_GT(f.scheduler.mask_age_ns(f.now), 9 * rt::kNsPerSecond) << "the age says that the mask is old";
  EXPECT_TRUE(f.changes.empty()) << "the tracker does not wait for it";
  f.detector = [](int) { return 40 * kMs; };
  f.done_at = f.now;
  f.fly(5 * rt::kNsPerSecond);
  EXPECT_FALSE(f.scheduler.detector_stuck());
  EXPECT_LT(f.scheduler.mask_age_ns(f.now), 300 * kMs);
  EXPECT_EQ(f.scheduler.plan().input_px, 416) << "what hung once says nothing of the next";
  EXPECT_LT(f.scheduler.plan().period_ns, 150 * kMs);
}

TEST(Scheduler, ADetectorThatHangsEachTimeIsASlowOne) {
  Flown f(with_detector());
  f.detector = [](int) { return 2500 * kMs; };
  f.fly(kMinute);
  EXPECT_EQ(f.scheduler.plan().input_px, 320);
  EXPECT_GT(f.scheduler.plan().period_ns, 1500 * kMs);
}

TEST(Scheduler, GoesDownOneRungAtATimeAndClimbsBack) {
  Flown f(with_detector());
  f.tracker = [](const SchedulePlan&) { return 20 * kMs; };
  f.fly(kMinute);
  ASSERT_EQ(f.changes.size(), 3u) << "slow, and in time: the detector stays";
  f.tracker = [](const SchedulePlan&) { return 40 * kMs; };
  f.fly(kMinute);
  ASSERT_EQ(f.changes.size(), 4u) << "to the last rung, and then there is nothing left to shed";
  for (std::size_t i = 0; i < 4; ++i) {
    EXPECT_EQ(static_cast<std::size_t>(f.changes[i].from), i);
    EXPECT_EQ(static_cast<std::size_t>(f.changes[i].to), i + 1);
    EXPECT_EQ(f.changes[i].reason, i < 3 ? RungReason::kSlowTracker : RungReason::kSlips);
    EXPECT_NEAR(f.changes[i].value, 20, 0.1);
    EXPECT_EQ(f.changes[i].limit, i < 3 ? 15 : 20);
    if (i > 0) {
      EXPECT_GE(f.changes[i].t_ns - f.changes[i - 1].t_ns, 2 * rt::kNsPerSecond) << "a step shows its effect";
    }
  }
  EXPECT_EQ(f.rung(), Rung::kDetectorOff);
  EXPECT_FALSE(f.scheduler.plan().detector_on);
  EXPECT_LT(f.scheduler.plan().feature_share, 1);
  const int detector_frames = f.detector_frames;
  f.fly(kMinute);
  EXPECT_LE(f.detector_frames - detector_frames, 3);

  f.tracker = [](const SchedulePlan&) { return 5 * kMs; };
  f.changes.clear();
  f.fly(2 * kMinute);
  ASSERT_EQ(f.changes.size(), 4u);
  for (std::size_t i = 0; i < 4; ++i) {
    EXPECT_EQ(f.changes[i].reason, RungReason::kCalm);
    EXPECT_EQ(static_cast<std::size_t>(f.changes[i].to), 3 - i);
    if (i > 0) {
      EXPECT_GE(f.changes[i].t_ns - f.changes[i - 1].t_ns, 10 * rt::kNsPerSecond);
    }
  }
  EXPECT_EQ(f.rung(), Rung::kFull);
  EXPECT_EQ(f.scheduler.plan().feature_share, 1);
  EXPECT_EQ(f.scheduler.counters().steps_down, 4u);
  EXPECT_EQ(f.scheduler.counters().steps_up, 4u);
}

TEST(Scheduler, StopsAtTheRungThatHelps) {
  Flown f(with_detector());
  // The detector's large input costs the tracker its cache.
  f.tracker = [](const SchedulePlan& p) { return p.detector_on && p.input_px > 320 ? 18 * kMs : 9 * kMs; };
  f.fly(20 * kMinute);
  EXPECT_EQ(f.changes[0].to, Rung::kSmallInput);
  for (const RungChange& c : f.changes) EXPECT_LE(c.to, Rung::kSmallInput) << "never deeper than needed";
  // Each climb relapses; the tries become rarer: 10, 20, 40, 80, 160 s and so on, about ten in twenty minutes.
  EXPECT_LT(f.scheduler.counters().steps_up, 12u);
  EXPECT_GT(f.scheduler.counters().time_on_rung_ns[1], 18 * kMinute);
}

TEST(Scheduler, WithoutDetectorOnlyTheTrackersRungIsTaken) {
  Flown f(SchedulerOptions{});
  f.tracker = [](const SchedulePlan& p) { return static_cast<rt::TimeNs>(20 * kMs * p.feature_share); };
  f.fly(kMinute / 2);
  ASSERT_FALSE(f.changes.empty());
  EXPECT_EQ(f.changes[0].to, Rung::kFewFeatures);
  EXPECT_EQ(f.changes.size(), 1u) << "12 ms is below the limit, and too near to it to climb";
  EXPECT_FALSE(f.scheduler.plan().detector_on);
}

TEST(Scheduler, LatePosesNowAndThenAreHarmless) {
  Flown f(with_detector());
  f.tracker = [&](const SchedulePlan&) { return f.frames % 300 == 0 ? 40 * kMs : 4 * kMs; };
  f.fly(10 * kMinute);
  EXPECT_GT(f.scheduler.counters().slips, 50u);
  EXPECT_TRUE(f.changes.empty()) << "one in ten seconds";
  f.tracker = [&](const SchedulePlan&) { return f.frames % 60 < 2 ? 40 * kMs : 4 * kMs; };
  f.fly(10 * kMinute);
  EXPECT_TRUE(f.changes.empty()) << "two in two seconds";
  EXPECT_GT(f.scheduler.counters().dropped, 0u);
  Flown late(with_detector());
  late.tracker = [&](const SchedulePlan&) { return late.frames >= 300 && late.frames < 306 ? 40 * kMs : 4 * kMs; };
  late.fly(11 * rt::kNsPerSecond);
  ASSERT_EQ(late.changes.size(), 1u) << "six";
  EXPECT_EQ(late.changes[0].reason, RungReason::kSlips);
}

// A machine that is busy with something else: one pose in five comes late whatever is shed.
TEST(Scheduler, MasksAreNotGivenUpForPosesThatAreALittleLate) {
  Flown f(with_detector());
  f.tracker = [&](const SchedulePlan&) { return f.frames % 5 == 0 ? 40 * kMs : 4 * kMs; };
  f.fly(10 * kMinute);
  EXPECT_EQ(f.rung(), Rung::kFewFeatures);
  EXPECT_GT(f.scheduler.counters().detections, 1000u);
  f.tracker = [&](const SchedulePlan&) { return f.frames % 2 == 0 ? 40 * kMs : 4 * kMs; };
  f.fly(10 * rt::kNsPerSecond);
  EXPECT_EQ(f.rung(), Rung::kDetectorOff) << "every second one is no flight";
}

TEST(Scheduler, TheLadderIsClimbedWhileThePoseIsLost) {
  Flown f(with_detector());
  f.tracker = [](const SchedulePlan&) { return 40 * kMs; };
  f.fly(kMinute / 2);
  ASSERT_EQ(f.rung(), Rung::kDetectorOff);
  // Lost: nothing is tracked, and nothing is late any more.
  Scheduler& s = f.scheduler;
  for (int i = 0; i < 30 * 180; ++i, f.now += kFrame) s.frame_done(f.now, -1, 10 * kMs, 0);
  EXPECT_EQ(f.rung(), Rung::kFull);
}

TEST(Scheduler, HeatAndThrottlingShedAndCoolingClimbs) {
  Flown f(with_detector());
  f.scheduler.machine(90, false);
  f.fly(5 * rt::kNsPerSecond);
  ASSERT_FALSE(f.changes.empty());
  EXPECT_EQ(f.changes[0].reason, RungReason::kTemperature);
  EXPECT_EQ(f.changes[0].value, 90);
  f.scheduler.machine(80, false);
  f.fly(kMinute);
  const Rung held = f.rung();
  EXPECT_NE(held, Rung::kFull) << "80 degrees is not hot, and not cool either: it stays";
  f.scheduler.machine(60, false);
  f.fly(2 * kMinute);
  EXPECT_EQ(f.rung(), Rung::kFull);
  f.changes.clear();
  f.scheduler.machine(std::nan(""), true);
  f.fly(3 * rt::kNsPerSecond);
  ASSERT_FALSE(f.changes.empty());
  EXPECT_EQ(f.changes[0].reason, RungReason::kThrottled);
  f.scheduler.machine(std::nan(""), false);
  f.fly(3 * kMinute);
  EXPECT_EQ(f.rung(), Rung::kFull) << "an unknown temperature holds nothing down";
}

TEST(Scheduler, FramesThatAreNotTrackedSayNothingOfTheTrackersCost) {
  Scheduler scheduler{SchedulerOptions{}};
  rt::TimeNs now = rt::kNsPerSecond;
  for (int i = 0; i < 290; ++i, now += kFrame) EXPECT_FALSE(scheduler.frame_done(now, -1, 25 * kMs, 0));
  EXPECT_EQ(scheduler.tracker_p95_ns(), 0);
  for (int i = 0; i < 30; ++i, now += kFrame) EXPECT_FALSE(scheduler.frame_done(now, i * kMs / 10, 25 * kMs, 0));
  EXPECT_EQ(scheduler.tracker_p95_ns(), 28 * kMs / 10) << "of 0.0 to 2.9 ms";
}

TEST(Scheduler, WithOneNetworkThereIsNoSmallerInputToStepTo) {
  SchedulerOptions options = with_detector();
  options.small_input_px = options.input_px;
  Flown f(options);
  f.tracker = [](const SchedulePlan& p) { return p.rung == Rung::kFull ? 20 * kMs : 5 * kMs; };
  f.fly(20 * rt::kNsPerSecond);
  ASSERT_FALSE(f.changes.empty());
  EXPECT_EQ(f.changes[0].from, Rung::kFull);
  EXPECT_EQ(f.changes[0].to, Rung::kLongPeriod);
  for (const RungChange& c : f.changes) EXPECT_NE(c.to, Rung::kSmallInput);
  EXPECT_GT(f.scheduler.counters().steps_up, 0u) << "nor on the way up";
}

TEST(Scheduler, ADetectionWithoutAMaskIsCountedAndMakesNoMaskYounger) {
  Scheduler scheduler(with_detector());
  ASSERT_TRUE(scheduler.order(kFrame, true));
  scheduler.detection_done(2 * kFrame, kFrame, false);
  ASSERT_TRUE(scheduler.order(10 * kFrame, true));
  scheduler.detection_done(11 * kFrame, 10 * kFrame, true);
  EXPECT_EQ(scheduler.counters().detections, 2u);
  EXPECT_EQ(scheduler.counters().detections_failed, 1u);
  EXPECT_EQ(scheduler.mask_age_ns(12 * kFrame), 11 * kFrame);
}

TEST(Scheduler, CountsEveryFrameAndEveryChangeOnce) {
  Flown f(with_detector());
  std::mt19937 random(2);
  std::uniform_real_distribution<double> slow(3, 24);
  double level = 5;
  f.tracker = [&](const SchedulePlan&) {
    if (f.frames % 3000 == 0) level = slow(random);
    return static_cast<rt::TimeNs>(level * kMs);
  };
  f.fly(120 * kMinute);
  const SchedulerCounters& c = f.scheduler.counters();
  EXPECT_EQ(c.frames, static_cast<std::uint64_t>(f.frames));
  EXPECT_EQ(c.steps_down + c.steps_up, f.changes.size());
  std::uint64_t reasons = 0;
  for (const std::uint64_t n : c.by_reason) reasons += n;
  EXPECT_EQ(reasons, f.changes.size());
  for (std::size_t i = 1; i < f.changes.size(); ++i) {
    EXPECT_EQ(f.changes[i].from, f.changes[i - 1].to);
    EXPECT_EQ(std::abs(static_cast<int>(f.changes[i].to) - static_cast<int>(f.changes[i].from)), 1);
  }
  rt::TimeNs total = 0;
  for (const rt::TimeNs t : c.time_on_rung_ns) total += t;
  EXPECT_NEAR(rt::to_seconds(total), 7200, 1);
}

}  // namespace scheduler_test
}  // namespace godwit::app
