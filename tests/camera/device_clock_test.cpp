#include "hal/camera/v4l2/device_clock.h"

#include <cmath>
#include <gtest/gtest.h>
#include <random>

namespace godwit::hal {
namespace {

using Source = DeviceClock::Source;
using Verdict = DeviceClock::Verdict;
constexpr rt::TimeNs kMs = rt::kNsPerMs;

/// Pictures at 30 Hz, stamped by a clock that is `offset` off and drifts by ppm, arriving 1 ms late and more: the
/// largest error of the times behind the first `skip` seconds [ms].
double worst_error_ms(DeviceClock* clock, rt::TimeNs offset, double ppm, double skip_s, double load_ms) {
  std::mt19937 random(7);
  std::exponential_distribution<double> late(1.0 / load_ms);
  double worst = 0;
  for (int i = 0; i < 30 * 120; ++i) {
    const rt::TimeNs t = 1000 * rt::kNsPerSecond + i * 33'333'333LL;
    const auto stamp = t - offset + static_cast<rt::TimeNs>(ppm * 1e-6 * static_cast<double>(i) * 33'333'333.0);
    const auto arrival = t + kMs + static_cast<rt::TimeNs>(late(random) * 1e6);
    const DeviceClock::Reading r = clock->take(stamp, arrival);
    EXPECT_EQ(r.verdict, Verdict::kGood) << i;
    if (i > 30 * skip_s) worst = std::max(worst, std::abs(static_cast<double>(r.t_ns - t)) * 1e-6);
  }
  return worst;
}

TEST(DeviceClock, AMonotonicStampIsTakenAsItIs) {
  DeviceClock clock;
  clock.start({}, 0);
  EXPECT_EQ(worst_error_ms(&clock, 0, 0, 0, 3), 0);
  EXPECT_EQ(clock.source(), Source::kMonotonic);
}

TEST(DeviceClock, AKnownOffsetIsUsedAndItsDriftFollowed) {
  for (const int sign : {1, -1}) {
    DeviceClock clock;
    clock.start({0, 0, sign * 29 * rt::kNsPerSecond}, 0);
    EXPECT_LT(worst_error_ms(&clock, 29 * rt::kNsPerSecond, 0, 0, 3), 1);
    EXPECT_EQ(clock.source(), Source::kCounter);
  }
  DeviceClock clock;
  clock.start({5000 * rt::kNsPerSecond, 0, {}}, 0);
  EXPECT_LT(worst_error_ms(&clock, 5000 * rt::kNsPerSecond, 100, 0, 3), 1);
  EXPECT_EQ(clock.source(), Source::kBoottime);
}

TEST(DeviceClock, AnUnknownOffsetIsMeasuredWithinTheLeastDelay) {
  for (const double ppm : {-100.0, 0.0, 100.0}) {
    DeviceClock clock;
    clock.start({}, 0);
    // 1 ms is the least delay, which nobody can know; 1 ms for what the seconds' minima scatter.
    EXPECT_LT(worst_error_ms(&clock, -1234 * rt::kNsPerSecond, ppm, 2, 3), 2) << ppm;
    EXPECT_EQ(clock.source(), Source::kMeasured);
  }
}

TEST(DeviceClock, AFirstPictureThatIsLateSpoilsNothing) {
  DeviceClock clock;
  clock.start({}, 0);
  rt::TimeNs t = 1000 * rt::kNsPerSecond;
  EXPECT_EQ(clock.take(t - 50 * rt::kNsPerSecond, t + 400 * kMs).verdict, Verdict::kGood);
  t += 33 * kMs;
  const auto r = clock.take(t - 50 * rt::kNsPerSecond, t + 401 * kMs);
  EXPECT_EQ(r.verdict, Verdict::kGood);
  t += 500 * kMs;
  EXPECT_EQ(clock.take(t - 50 * rt::kNsPerSecond, t + kMs).t_ns, t + kMs);
}

TEST(DeviceClock, PicturesThatWaitedForABusyMachineAreOldNotMistimed) {
  DeviceClock clock;
  clock.start({}, 0);
  rt::TimeNs stamp = 1000 * rt::kNsPerSecond;
  for (rt::TimeNs delay = kMs; delay < 3 * rt::kNsPerSecond; delay += 120 * kMs) {
    stamp += 33 * kMs;
    const auto r = clock.take(stamp, stamp + delay);
    EXPECT_EQ(r.verdict, Verdict::kGood);
    EXPECT_EQ(r.t_ns, stamp);
  }
  EXPECT_EQ(clock.source(), Source::kMonotonic);
}

TEST(DeviceClock, RepeatedStampsAreRefusedAndThenArrivalsUsed) {
  DeviceClock clock;
  clock.start({}, 2 * kMs);
  rt::TimeNs now = 1000 * rt::kNsPerSecond;
  const rt::TimeNs stands = now;
  EXPECT_EQ(clock.take(stands, now).verdict, Verdict::kGood);
  EXPECT_EQ(clock.take(stands, now += 33 * kMs).verdict, Verdict::kRepeats);
  EXPECT_EQ(clock.take(stands, now += 33 * kMs).verdict, Verdict::kRepeats);
  const auto r = clock.take(stands, now += 33 * kMs);
  EXPECT_EQ(r.verdict, Verdict::kGood);
  EXPECT_TRUE(r.source_changed);
  EXPECT_EQ(r.t_ns, now - 2 * kMs);
  // It goes again.
  now += 33 * kMs;
  EXPECT_EQ(clock.take(now - kMs, now).verdict, Verdict::kGood);
  EXPECT_EQ(clock.source(), Source::kMonotonic);
}

TEST(DeviceClock, AStampThatGoesBackALittleIsRefusedAJumpIsFollowed) {
  DeviceClock clock;
  clock.start({}, 0);
  rt::TimeNs now = 1000 * rt::kNsPerSecond;
  EXPECT_EQ(clock.take(now, now + kMs).verdict, Verdict::kGood);
  EXPECT_EQ(clock.take(now - 10 * kMs, now + 20 * kMs).verdict, Verdict::kWentBack);
  now += 33 * kMs;
  EXPECT_EQ(clock.take(now, now + kMs).verdict, Verdict::kGood);
  now += 33 * kMs;
  const auto jump = clock.take(now - 60 * rt::kNsPerSecond, now + kMs);
  EXPECT_EQ(jump.verdict, Verdict::kJumped);
  EXPECT_LT(jump.off_ns, -59 * rt::kNsPerSecond);
  now += 33 * kMs;
  const auto after = clock.take(now - 60 * rt::kNsPerSecond, now + kMs);
  EXPECT_EQ(after.verdict, Verdict::kGood);
  EXPECT_EQ(after.t_ns, now + kMs);
}

}  // namespace
}  // namespace godwit::hal
