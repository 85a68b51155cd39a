#include "hal/camera/device/device_clock.h"

#include <cmath>
#include <gtest/gtest.h>
#include <random>

namespace godwit::hal::device_clock_test {
namespace {

using Source = DeviceClock::Source;
using Verdict = DeviceClock::Verdict;
constexpr rt::TimeNs kMs = rt::kNsPerMs;

/// Pictures at 30 Hz, stamped by a clock that is `offset` off and drifts by ppm, arriving 1 ms late and more: the
/// largest error of the times behind the first `skip` seconds [ms].
double worst_error_ms(DeviceClock* clock, const ClockOffsets& offsets, rt::TimeNs offset, double ppm, double skip_s,
                      double load_ms) {
  std::mt19937 random(7);
  std::exponential_distribution<double> late(1.0 / load_ms);
  double worst = 0;
  for (int i = 0; i < 30 * 120; ++i) {
    const rt::TimeNs t = 1000 * rt::kNsPerSecond + i * 33'333'333LL;
    const auto stamp = t - offset + static_cast<rt::TimeNs>(ppm * 1e-6 * static_cast<double>(i) * 33'333'333.0);
    const auto arrival = t + kMs + static_cast<rt::TimeNs>(late(random) * 1e6);
    const DeviceClock::Reading r = clock->take(stamp, arrival, offsets, 0);
    EXPECT_EQ(r.verdict, Verdict::kGood) << i;
    if (i > 30 * skip_s) worst = std::max(worst, std::abs(static_cast<double>(r.t_ns - t)) * 1e-6);
  }
  return worst;
}

TEST(DeviceClock, AMonotonicStampIsTakenAsItIs) {
  DeviceClock clock;
  EXPECT_EQ(worst_error_ms(&clock, {}, 0, 0, 0, 3), 0);
  EXPECT_EQ(clock.source(), Source::kMonotonic);
}

TEST(DeviceClock, AKnownOffsetIsUsedAndLoadIsNoDrift) {
  for (const int sign : {1, -1}) {
    DeviceClock clock;
    EXPECT_EQ(worst_error_ms(&clock, {0, 0, sign * 29 * rt::kNsPerSecond}, 29 * rt::kNsPerSecond, 0, 0, 3), 0);
    EXPECT_EQ(clock.source(), Source::kCounter);
  }
  DeviceClock clock;
  EXPECT_EQ(worst_error_ms(&clock, {5000 * rt::kNsPerSecond, 0, {}}, 5000 * rt::kNsPerSecond, 0, 0, 3), 0);
  EXPECT_EQ(clock.source(), Source::kBoottime);
}

TEST(DeviceClock, AKnownOffsetNeitherFollowsALoadThatStaysNorALongerExposure) {
  for (const rt::TimeNs exposure : {0 * kMs, 12 * kMs}) {
    DeviceClock clock;
    const ClockOffsets offsets{0, 0, 29 * rt::kNsPerSecond};
    for (int i = 0; i < 30 * 60; ++i) {
      const rt::TimeNs t = 1000 * rt::kNsPerSecond + i * 33 * kMs;
      // From the tenth second on pictures come 12 ms later.
      const rt::TimeNs late = i < 300 ? kMs : 13 * kMs;
      const auto r = clock.take(t + 29 * rt::kNsPerSecond, t + late, offsets, i < 300 ? 0 : exposure);
      ASSERT_EQ(r.verdict, Verdict::kGood);
      ASSERT_EQ(r.t_ns, t) << i;
    }
  }
}

TEST(DeviceClock, AKnownOffsetIsTakenAsTheMachineHasItNow) {
  DeviceClock clock;
  for (int i = 0; i < 30 * 60; ++i) {
    const rt::TimeNs t = 1000 * rt::kNsPerSecond + i * 33 * kMs;
    const rt::TimeNs drift = i * 3300;  // 100 ppm
    const ClockOffsets offsets{0, 0, 29 * rt::kNsPerSecond + drift};
    const auto r = clock.take(t + 29 * rt::kNsPerSecond + drift, t + 7 * kMs, offsets, 0);
    ASSERT_EQ(r.verdict, Verdict::kGood);
    ASSERT_EQ(r.t_ns, t) << i;
  }
}

TEST(DeviceClock, RealtimeThatIsSetCostsOnePictureAndMovesNoOther) {
  for (const rt::TimeNs step : {-700 * kMs, -20 * kMs, 20 * kMs, 700 * kMs, -3600 * rt::kNsPerSecond}) {
    DeviceClock clock;
    rt::TimeNs ahead = 1'700'000'000LL * rt::kNsPerSecond;
    int refused = 0;
    for (int i = 0; i < 300; ++i) {
      const rt::TimeNs t = 1000 * rt::kNsPerSecond + i * 33 * kMs;
      if (i == 100) ahead += step;  // the picture before that is stamped before
      // The offset is read when the picture comes, the stamp was taken 5 ms before.
      const auto r = clock.take(t + ahead, t + 5 * kMs, {0, -ahead, {}}, 0);
      if (r.verdict != Verdict::kGood) {
        EXPECT_EQ(r.verdict, Verdict::kJumped) << step;
        EXPECT_EQ(i, 100);
        ++refused;
        continue;
      }
      ASSERT_EQ(r.t_ns, t) << step << " " << i;
    }
    EXPECT_EQ(refused, 1) << step;
    EXPECT_EQ(clock.source(), Source::kRealtime);
  }
}

TEST(DeviceClock, AKnownOffsetThatCannotBeTrueIsTold) {
  DeviceClock clock;
  int told = 0;
  // A file that says half a second too little: pictures seem to come late, all of them.
  for (int i = 0; i < 300; ++i) {
    const rt::TimeNs t = 1000 * rt::kNsPerSecond + i * 33 * kMs;
    const auto r = clock.take(t - 500 * kMs + 29 * rt::kNsPerSecond, t + kMs, {0, 0, 29 * rt::kNsPerSecond}, 0);
    if (r.late) {
      ++told;
      EXPECT_EQ(r.off_ns, 501 * kMs);
    }
  }
  EXPECT_EQ(told, 1);
  // Half a second too much: they would come before they happened, which nothing does. It is measured.
  DeviceClock other;
  for (int i = 0; i < 10; ++i) {
    const rt::TimeNs t = 1000 * rt::kNsPerSecond + i * 33 * kMs;
    EXPECT_LE(other.take(t + 500 * kMs + 29 * rt::kNsPerSecond, t + kMs, {0, 0, 29 * rt::kNsPerSecond}, 0).t_ns,
              t + kMs);
  }
  EXPECT_EQ(other.source(), Source::kMeasured);
}

TEST(DeviceClock, AnExposureThatChangesMovesNoTimeOfAMeasuredClock) {
  // Stamps of the start; the exposure behind them is 5 ms, and 15 ms for ten seconds. The camera learns of a change
  // three pictures before it is in one, or six behind.
  for (const int known_after : {-3, 0, 6}) {
    DeviceClock clock;
    double worst_ms = 0;
    for (int i = 0; i < 30 * 40; ++i) {
      const auto exposure = [](int picture) { return picture >= 450 && picture < 750 ? 15 * kMs : 5 * kMs; };
      const rt::TimeNs t = 1000 * rt::kNsPerSecond + i * 33 * kMs;
      const rt::TimeNs arrival = t + exposure(i) + kMs + (i % 7) * 300'000;
      const auto r = clock.take(t - 50 * rt::kNsPerSecond, arrival, {}, exposure(i - known_after));
      ASSERT_EQ(r.verdict, Verdict::kGood);
      if (i > 30) worst_ms = std::max(worst_ms, std::abs(static_cast<double>(r.t_ns - t)) * 1e-6);
    }
    EXPECT_LT(worst_ms, 2) << known_after;  // 1 ms of it is the least delay, which nobody knows
    EXPECT_EQ(clock.source(), Source::kMeasured);
  }
}

TEST(DeviceClock, AnUnknownOffsetIsMeasuredWithinTheLeastDelay) {
  for (const double ppm : {-100.0, 0.0, 100.0}) {
    DeviceClock clock;
    // 1 ms is the least delay, which nobody can know; 1 ms for what the seconds' minima scatter.
    EXPECT_LT(worst_error_ms(&clock, {}, -1234 * rt::kNsPerSecond, ppm, 3, 3), 2) << ppm;
    EXPECT_EQ(clock.source(), Source::kMeasured);
  }
}

TEST(DeviceClock, AFirstPictureThatIsLateSpoilsNothing) {
  DeviceClock clock;
  rt::TimeNs t = 1000 * rt::kNsPerSecond;
  EXPECT_EQ(clock.take(t - 50 * rt::kNsPerSecond, t + 400 * kMs, {}, 0).verdict, Verdict::kGood);
  t += 33 * kMs;
  const auto r = clock.take(t - 50 * rt::kNsPerSecond, t + 401 * kMs, {}, 0);
  EXPECT_EQ(r.verdict, Verdict::kGood);
  t += 500 * kMs;
  EXPECT_EQ(clock.take(t - 50 * rt::kNsPerSecond, t + kMs, {}, 0).t_ns, t + kMs);
}

TEST(DeviceClock, PicturesThatWaitedForABusyMachineAreOldNotMistimed) {
  DeviceClock clock;
  rt::TimeNs stamp = 1000 * rt::kNsPerSecond;
  for (rt::TimeNs delay = kMs; delay < 3 * rt::kNsPerSecond; delay += 120 * kMs) {
    stamp += 33 * kMs;
    const auto r = clock.take(stamp, stamp + delay, {}, 0);
    EXPECT_EQ(r.verdict, Verdict::kGood);
    EXPECT_EQ(r.t_ns, stamp);
  }
  EXPECT_EQ(clock.source(), Source::kMonotonic);
}

TEST(DeviceClock, PicturesThatLayWhileNobodyLookedAreOldNotNew) {
  // Four buffers are filled within 0.1 s, then nobody looks for three seconds. They were dated as if just taken.
  for (const rt::TimeNs offset : {rt::TimeNs{0}, 50 * rt::kNsPerSecond}) {  // monotonic, and a clock of its own
    DeviceClock clock;
    rt::TimeNs t = 1000 * rt::kNsPerSecond;
    const auto look = [&](rt::TimeNs taken, rt::TimeNs arrival) {
      const auto r = clock.take(taken - offset, arrival, {}, 0);
      EXPECT_EQ(r.verdict, Verdict::kGood);
      EXPECT_NEAR(static_cast<double>(r.t_ns - taken), 0, 2e6);
    };
    for (int i = 0; i < 90; ++i, t += 33 * kMs) look(t, t + kMs);
    for (int i = 0; i < 4; ++i) look(t + i * 33 * kMs, t + 3 * rt::kNsPerSecond + i * kMs);
    t += 3 * rt::kNsPerSecond;
    for (int i = 0; i < 90; ++i, t += 33 * kMs) look(t, t + kMs);
  }
}

TEST(DeviceClock, AClockThatWasSetBackInASilenceIsFollowedAfterASecond) {
  DeviceClock clock;
  rt::TimeNs t = 1000 * rt::kNsPerSecond;
  for (int i = 0; i < 30; ++i, t += 33 * kMs) clock.take(t, t + kMs, {}, 0);
  t += 10 * rt::kNsPerSecond;
  const rt::TimeNs back = 5 * rt::kNsPerSecond;
  int jumps = 0, old = 0;
  for (int i = 0; i < 90; ++i, t += 33 * kMs) {
    const auto r = clock.take(t - back, t + kMs, {}, 0);
    jumps += r.verdict == Verdict::kJumped ? 1 : 0;
    if (r.verdict == Verdict::kGood && jumps == 0) ++old;
    if (jumps > 0 && r.verdict == Verdict::kGood) {
      EXPECT_NEAR(static_cast<double>(r.t_ns - t), 0, 2e6);
    }
  }
  EXPECT_EQ(jumps, 1);
  EXPECT_LE(old, 32);
}

TEST(DeviceClock, RepeatedStampsAreRefusedAndThenArrivalsUsed) {
  DeviceClock clock;
  const rt::TimeNs least = 2 * kMs;
  rt::TimeNs now = 1000 * rt::kNsPerSecond;
  const rt::TimeNs stands = now;
  EXPECT_EQ(clock.take(stands, now, {}, least).verdict, Verdict::kGood);
  EXPECT_EQ(clock.take(stands, now += 33 * kMs, {}, least).verdict, Verdict::kRepeats);
  EXPECT_EQ(clock.take(stands, now += 33 * kMs, {}, least).verdict, Verdict::kRepeats);
  const auto r = clock.take(stands, now += 33 * kMs, {}, least);
  EXPECT_EQ(r.verdict, Verdict::kGood);
  EXPECT_TRUE(r.source_changed);
  EXPECT_EQ(r.t_ns, now - least);
  // It goes again.
  now += 33 * kMs;
  EXPECT_EQ(clock.take(now - kMs, now, {}, least).verdict, Verdict::kGood);
  EXPECT_EQ(clock.source(), Source::kMonotonic);
}

TEST(DeviceClock, AStampThatGoesBackALittleIsRefusedAJumpIsFollowed) {
  DeviceClock clock;
  rt::TimeNs now = 1000 * rt::kNsPerSecond;
  EXPECT_EQ(clock.take(now, now + kMs, {}, 0).verdict, Verdict::kGood);
  EXPECT_EQ(clock.take(now - 10 * kMs, now + 20 * kMs, {}, 0).verdict, Verdict::kWentBack);
  now += 33 * kMs;
  EXPECT_EQ(clock.take(now, now + kMs, {}, 0).verdict, Verdict::kGood);
  now += 33 * kMs;
  const auto jump = clock.take(now - 60 * rt::kNsPerSecond, now + kMs, {}, 0);
  EXPECT_EQ(jump.verdict, Verdict::kJumped);
  EXPECT_LT(jump.off_ns, -59 * rt::kNsPerSecond);
  now += 33 * kMs;
  const auto after = clock.take(now - 60 * rt::kNsPerSecond, now + kMs, {}, 0);
  EXPECT_EQ(after.verdict, Verdict::kGood);
  EXPECT_EQ(after.t_ns, now + kMs);
}

}  // namespace
}  // namespace godwit::hal::device_clock_test
