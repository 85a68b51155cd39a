// One frame through losses and new maps: place, heading and speed go on, what is told of them holds, and what cannot be
// tied together is told as a new frame.
#include "vo_core/inertial/navigation_frame.h"

#include <Eigen/Cholesky>
#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <string>

#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"
#include "tests/vo_core/navigation_flown.h"

namespace godwit::vo {
namespace navigation_frame_test {

using Flown = test::NavigationFlown;
using Source = NavigationPose::Source;

double nees(const Vec6& e, const Mat6& C) {
  return e.dot(C.llt().solve(e)) / 6;
}

TEST(NavigationFrame, TheFirstFrameIsPassedOnAsItIs) {
  Flown f(1);
  const NavigationPose none = f.navigation_.frame(0, nullptr);
  EXPECT_EQ(none.source, Source::kNone);
  EXPECT_EQ(none.frame_id, 0u);
  f.feel(1);
  const MetricMoment m = f.moment(0.05);
  const NavigationPose pose = f.navigation_.frame(Flown::time(1), &m);
  EXPECT_EQ(pose.source, Source::kSeen);
  EXPECT_EQ(pose.frame_id, 1u);
  EXPECT_LT((pose.T_nav_cam.t - m.T_child_cam.t).norm(), 1e-12);
  EXPECT_LT((pose.T_nav_cam.R - m.T_child_cam.R).norm(), 1e-12);
  EXPECT_LT((pose.covariance - m.covariance).norm(), 1e-15) << "where it began is where it is counted from";
  EXPECT_LT((pose.velocity_m_s - m.velocity_m_s).norm(), 1e-12);
}

TEST(NavigationFrame, ASecondWithoutPicturesIsBridgedInsideItsCovariance) {
  double sum = 0, worst = 0;
  int n = 0;
  for (unsigned seed = 1; seed <= 30; ++seed) {
    Flown f(seed);
    for (int k = 0; k < 40; ++k) ASSERT_EQ(f.frame(k).source, Source::kSeen);
    NavigationPose pose;
    for (int k = 40; k < 60; ++k) {
      pose = f.frame(k, false);
      ASSERT_EQ(pose.source, Source::kCoasted) << pose.why << " " << pose.value;
      EXPECT_EQ(pose.frame_id, 1u);
      const Vec6 e = f.error(k, pose);
      worst = std::max(worst, e.head<3>().norm());
      sum += nees(e, pose.covariance);
      ++n;
      EXPECT_LT((pose.velocity_m_s - f.true_speed(k)).norm(), 5 * std::sqrt(pose.velocity_covariance.trace()));
    }
    const NavigationPose back = f.frame(60);
    EXPECT_EQ(back.source, Source::kSeen);
    EXPECT_EQ(back.frame_id, 1u) << "the same map is no new frame";
    EXPECT_LT(f.error(60, back).norm(), 0.03);
    EXPECT_GT(back.moved_by_m.norm(), 1e-6) << "what dead reckoning was off by is told";
    EXPECT_LT(back.moved_by_m.norm(), 4 * std::sqrt(pose.covariance.topLeftCorner<3, 3>().trace()) + 0.02);
  }
  EXPECT_LT(worst, 0.10);
  EXPECT_GT(sum / n, 0.3);
  EXPECT_LT(sum / n, 2.0);
}

TEST(NavigationFrame, ANewMapIsHungInWhereTheBodyIsAndItsCovarianceHolds) {
  double sum = 0, sum_place = 0, sigma_before = 0, sigma_after = 0;
  int n = 0;
  for (unsigned seed = 1; seed <= 40; ++seed) {
    Flown f(seed);
    for (int k = 0; k < 40; ++k) f.frame(k);
    for (int k = 40; k < 100; ++k) {
      const NavigationPose dark = f.frame(k, false);
      if (dark.source == Source::kCoasted) sigma_before = std::sqrt(dark.covariance.topLeftCorner<3, 3>().trace());
      ASSERT_EQ(dark.frame_id, 1u);
    }
    f.new_child();
    for (int k = 100; k < 120; ++k) {
      const NavigationPose pose = f.frame(k);
      ASSERT_EQ(pose.source, Source::kSeen);
      ASSERT_EQ(pose.frame_id, 1u) << seed << ": " << pose.why << " " << pose.value;
      const Vec6 e = f.error(k, pose);
      if (k == 100) {
        sum += nees(e, pose.covariance);
        sum_place += e.head<3>().norm();
        sigma_after += std::sqrt(pose.covariance.topLeftCorner<3, 3>().trace());
        ++n;
        EXPECT_LT(std::abs(e(5)), 0.03) << "heading goes on by the gyroscope, wherever the new map heads";
        EXPECT_LT(e.head<3>().norm(), 1.0);
      }
      EXPECT_LT((pose.velocity_m_s - f.true_speed(k)).norm(), 0.15) << k;
      EXPECT_LE(pose.moved_by_m.norm(), k == 100 ? 1.0 : 1e-9) << "told once, with the first";
    }
  }
  EXPECT_GT(sum / n, 0.3);
  EXPECT_LT(sum / n, 2.0);
  EXPECT_LT(sum_place / n, 0.25) << "after three seconds in the dark [m]";
  std::printf("three seconds dark: off by %.3f m, sigma told %.3f m (last coasted %.3f m), NEES %.2f\n", sum_place / n,
              sigma_after / n, sigma_before, sum / n);
}

// Ten seconds: dead reckoning is off by metres then, its sigma is beyond what may be joined on, and the new map's speed
// takes most of that back.
TEST(NavigationFrame, TheNewMapsSpeedIsHeardBeforeAFrameIsGivenUp) {
  double sum = 0, sum_place = 0, sigma_dark = 0;
  for (unsigned seed = 1; seed <= 40; ++seed) {
    Flown f(seed);
    for (int k = 0; k < 40; ++k) f.frame(k);
    for (int k = 40; k < 240; ++k) f.frame(k, false);
    NavigationFrame::Expected expected;
    ASSERT_TRUE(f.navigation_.expected(Flown::time(239), &expected));
    sigma_dark += (expected.T_child_cam.t - f.true_place(239)).norm();
    f.new_child();
    const NavigationPose pose = f.frame(240);
    ASSERT_EQ(pose.frame_id, 1u) << seed << ": " << pose.why << " " << pose.value;
    const Vec6 e = f.error(240, pose);
    sum += nees(e, pose.covariance) / 40;
    sum_place += e.head<3>().norm();
  }
  EXPECT_GT(sum, 0.3);
  EXPECT_LT(sum, 2.0);
  EXPECT_LT(sum_place, 0.6 * sigma_dark) << "the speed takes most of it back";
  std::printf("ten seconds dark: off by %.2f m before the map, %.2f m with it, NEES %.2f\n", sigma_dark / 40,
              sum_place / 40, sum);
}

TEST(NavigationFrame, WhereTheCameraShouldBeIsToldInTheMapSeenLast) {
  Flown f(11);
  f.new_child();
  NavigationFrame::Expected there;
  for (int k = 0; k < 40; ++k) f.frame(k);
  MetricMoment m;
  for (int k = 40; k < 100; ++k) {
    f.feel(k);
    ASSERT_TRUE(f.navigation_.expected(Flown::time(k), &there));
    m = f.moment(k / 20.0);
    f.navigation_.frame(Flown::time(k), nullptr);
  }
  EXPECT_LT((there.T_child_cam.t - m.T_child_cam.t).norm(), 3 * there.place_sigma_m);
  EXPECT_LT(so3_log(there.T_child_cam.R.transpose() * m.T_child_cam.R).norm(), 3 * there.turn_sigma_rad);
  EXPECT_FALSE(f.navigation_.expected(Flown::time(200), &there)) << "nobody has measured that far";
}

TEST(NavigationFrame, CoastingEndsByTimeOrBySigmaAndSaysWhich) {
  NavigationOptions options;
  options.coast_ns = 400 * rt::kNsPerMs;
  Flown f(3, options);
  for (int k = 0; k < 20; ++k) f.frame(k);
  for (int k = 20; k < 60; ++k) {
    const NavigationPose pose = f.frame(k, false);
    EXPECT_EQ(pose.source, k <= 27 ? Source::kCoasted : Source::kNone) << k;
    if (k > 27) {
      EXPECT_NE(std::string(pose.why).find("too long"), std::string::npos) << pose.why;
    }
  }
  options.coast_ns = 100 * rt::kNsPerSecond;
  options.coast_sigma_m = 0.05;
  Flown g(3, options);
  for (int k = 0; k < 20; ++k) g.frame(k);
  NavigationPose pose;
  int k = 20;
  while ((pose = g.frame(k++, false)).source == Source::kCoasted && k < 200) {
    EXPECT_LE(std::sqrt(pose.covariance.topLeftCorner<3, 3>().trace()), 0.06);
  }
  EXPECT_LT(k, 100);
  EXPECT_NE(std::string(pose.why).find("uncertain"), std::string::npos) << pose.why;
}

TEST(NavigationFrame, WhatCannotBeTiedTogetherIsANewFrame) {
  Flown f(4);
  for (int k = 0; k < 20; ++k) f.frame(k);
  const Vec3 last = f.true_place(19);
  for (int k = 20; k < 1400; ++k) {
    const NavigationPose pose = f.frame(k, false);
    EXPECT_TRUE(pose.source == Source::kNone || k < 80);
  }
  f.new_child();
  const NavigationPose pose = f.frame(1400);
  EXPECT_EQ(pose.source, Source::kSeen);
  EXPECT_EQ(pose.frame_id, 2u);
  EXPECT_NE(std::string(pose.why).find("blind"), std::string::npos) << pose.why;
  EXPECT_LT(pose.covariance(0, 0), 1e-3) << "counted from where it began";
  EXPECT_EQ(pose.moved_by_m.norm(), 0.0) << "across frames nothing can be compared";
  EXPECT_LT((pose.T_nav_cam.t - last).norm(), 60) << "and it begins about where the last one ended";
  EXPECT_EQ(f.frame(1401).frame_id, 2u);
}

TEST(NavigationFrame, AMapThatDisagreesWithTheSensorIsNotTiedOn) {
  // Of another scale: its speed is wrong by a factor.
  Flown f(5);
  for (int k = 0; k < 20; ++k) f.frame(k);
  for (int k = 20; k < 40; ++k) f.frame(k, false);
  f.new_child();
  f.spoil_ = [](MetricMoment* m) { m->velocity_m_s *= 3; };
  NavigationPose pose = f.frame(40);
  EXPECT_EQ(pose.frame_id, 2u);
  EXPECT_NE(std::string(pose.why).find("speed"), std::string::npos) << pose.why;
  // Level by another vertical.
  Flown g(5);
  for (int k = 0; k < 20; ++k) g.frame(k);
  g.new_child();
  g.spoil_ = [](MetricMoment* m) { m->T_child_cam.R = so3_exp(Vec3(0.2, 0, 0)) * m->T_child_cam.R; };
  pose = g.frame(20);
  EXPECT_EQ(pose.frame_id, 2u);
  EXPECT_NE(std::string(pose.why).find("vertical"), std::string::npos) << pose.why;
}

TEST(NavigationFrame, VisionThatAgreesIsTrustedAndVisionThatDoesNotEndsTheFrameWithAReason) {
  double mean = 0;
  for (unsigned seed = 1; seed <= 10; ++seed) {
    Flown f(seed);
    for (int k = 0; k < 400; ++k) {
      const NavigationPose pose = f.frame(k);
      EXPECT_EQ(pose.frame_id, 1u);
      if (k > 100) {
        EXPECT_GT(pose.trust, 0.9);
      }
    }
    mean += f.navigation_.self_check().mean(CheckedBy::kInertial) / 10;
  }
  EXPECT_LT(mean, 2);
  // Vision's world is five times too large from some moment on.
  Flown f(3);
  for (int k = 0; k < 100; ++k) f.frame(k);
  f.spoil_ = [](MetricMoment* m) { m->T_child_cam.t *= 5; };
  double least = 1;
  int k = 100;
  NavigationPose pose;
  for (; k < 400 && (pose = f.frame(k)).frame_id == 1; ++k) least = std::min(least, pose.trust);
  EXPECT_LT(k, 300);
  EXPECT_LT(least, 0.5) << "less trust first";
  EXPECT_NE(std::string(pose.why).find("disagree"), std::string::npos) << pose.why;
}

// Moved by all of each correction, too, what dead reckoning began with a second ago was off by what vision strays by
// until it is corrected, though that was seen before it strayed.
TEST(NavigationFrame, ACorrectionOfTheMapTakesBackWhatVisionStrayedByAndNothingBefore) {
  constexpr int kPeriod = 16;  // kStrayedNs
  const Vec3 strays = Vec3(0.05, -0.03, 0.04) / kPeriod;
  const Vec3 turns = Vec3(0, 0, 0.01) / kPeriod;
  double mean = 0;
  for (unsigned seed = 1; seed <= 10; ++seed) {
    Flown f(seed);
    for (int k = 0; k < 400; ++k) {
      f.feel(k);
      MetricMoment m = f.moment(k / 20.0);
      const int since = k % kPeriod;
      m.T_child_cam.t += since * strays;
      m.T_child_cam.R = so3_exp(since * turns) * m.T_child_cam.R;
      m.velocity_m_s = so3_exp(since * turns) * m.velocity_m_s;
      if (since == 0 && k > 0) {
        m.moved_by_m = m.map_moved_by_m = -(kPeriod - 1) * strays;
        m.turned_by_rad = m.map_turned_by_rad = -(kPeriod - 1) * turns;
      }
      EXPECT_EQ(f.navigation_.frame(Flown::time(k), &m).frame_id, 1u);
    }
    mean += f.navigation_.self_check().mean(CheckedBy::kInertial) / 10;
  }
  EXPECT_LT(mean, 2);
}

// A new scale or vertical holds for what was told a second ago, too.
TEST(NavigationFrame, WhatIsNoCorrectionOfTheMapMovesAllAlike) {
  double mean = 0;
  for (unsigned seed = 1; seed <= 10; ++seed) {
    Flown f(seed);
    const Vec3 jumps(0.3, -0.2, 0.1);
    for (int k = 0; k < 400; ++k) {
      f.feel(k);
      MetricMoment m = f.moment(k / 20.0);
      m.T_child_cam.t += (k / 50) * jumps;
      if (k > 0 && k % 50 == 0) m.moved_by_m = jumps;
      f.navigation_.frame(Flown::time(k), &m);
    }
    mean += f.navigation_.self_check().mean(CheckedBy::kInertial) / 10;
  }
  EXPECT_LT(mean, 2);
}

TEST(NavigationFrame, WithoutReadingsItClaimsNothingAndTheCovarianceSaysWhatMayHaveHappened) {
  Flown f(6);
  for (int k = 0; k < 20; ++k) f.frame(k);
  f.silent_ = true;
  EXPECT_EQ(f.frame(20, false).source, Source::kNone);
  for (int k = 21; k < 40; ++k) {
    const NavigationPose pose = f.frame(k, false);
    EXPECT_EQ(pose.source, Source::kNone);
    EXPECT_NE(std::string(pose.why).find("silent"), std::string::npos) << pose.why;
  }
  f.silent_ = false;
  f.new_child();
  const NavigationPose pose = f.frame(40);
  const Vec6 e = f.error(40, pose);
  EXPECT_EQ(pose.frame_id, 1u);
  EXPECT_GT(std::sqrt(pose.covariance.topLeftCorner<3, 3>().trace()), 0.1);
  EXPECT_LT(nees(e, pose.covariance), 4);
}

TEST(NavigationFrame, ASilentCameraIsNoReasonToForget) {
  Flown f(7);
  for (int k = 0; k < 20; ++k) f.frame(k);
  for (int k = 20; k < 80; ++k) f.feel(k);  // three seconds, longer than readings are kept
  f.new_child();
  const NavigationPose pose = f.frame(80);
  EXPECT_EQ(pose.frame_id, 1u) << pose.why;
  EXPECT_LT(f.error(80, pose).head<3>().norm(), 0.6);
  EXPECT_LT(nees(f.error(80, pose), pose.covariance), 4);
}

TEST(NavigationFrame, NothingThatIsNoNumberLeavesIt) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  using Spoil = void (*)(MetricMoment*);
  const Spoil spoils[] = {
      [](MetricMoment* m) { m->T_child_cam.R(1, 2) = kNan; },
      [](MetricMoment* m) { m->T_child_cam.t.y() = kNan; },
      [](MetricMoment* m) { m->T_child_cam.R *= 2; },
      [](MetricMoment* m) { m->velocity_m_s.x() = kNan; },
      [](MetricMoment* m) { m->covariance(3, 0) = kNan; },
      [](MetricMoment* m) { m->covariance(2, 2) = -1; },
      [](MetricMoment* m) { m->velocity_covariance(1, 1) = kNan; },
      [](MetricMoment* m) { m->moved_by_m.z() = kNan; },
      [](MetricMoment* m) { m->turned_by_rad.z() = kNan; },
      [](MetricMoment* m) { m->map_moved_by_m.z() = kNan; },
      [](MetricMoment* m) { m->map_turned_by_rad.z() = kNan; },
      [](MetricMoment* m) { m->bias.gyro.x() = kNan; },
      [](MetricMoment* m) { m->bias.accel.x() = kNan; },
      [](MetricMoment* m) { m->gyro_bias_sigma = kNan; },
      [](MetricMoment* m) { m->accel_bias_sigma = std::numeric_limits<double>::infinity(); },
      [](MetricMoment* m) { m->R_body_cam(0, 0) = kNan; },
      [](MetricMoment* m) { m->time_offset_s = kNan; },
  };
  Flown f(8);
  int k = 0;
  for (; k < 20; ++k) f.frame(k);
  for (const Spoil spoil : spoils) {
    f.spoil_ = spoil;
    const NavigationPose pose = f.frame(k++);
    EXPECT_EQ(pose.source, Source::kCoasted) << "as if it had not been seen";
    EXPECT_TRUE(pose.T_nav_cam.R.allFinite() && pose.T_nav_cam.t.allFinite() && pose.velocity_m_s.allFinite() &&
                pose.covariance.allFinite() && pose.velocity_covariance.allFinite());
    f.spoil_ = nullptr;
    EXPECT_EQ(f.frame(k++).source, Source::kSeen);
  }
  ImuReading reading = f.flight_.reading(k / 20.0);
  reading.gyro_rad_s.x() = kNan;
  EXPECT_FALSE(f.navigation_.add(reading));
  EXPECT_EQ(f.frame(k).source, Source::kSeen);
}

TEST(NavigationFrame, DoesNotAllocate) {
  Flown f(9);
  const rt::HeapCounts before = rt::rt_heap_counts();
  {
    const rt::RtScope real_time;
    for (int k = 0; k < 20; ++k) f.frame(k);
    for (int k = 20; k < 40; ++k) f.frame(k, false);
    f.new_child();
    for (int k = 40; k < 60; ++k) f.frame(k);
  }
  EXPECT_EQ(rt::rt_heap_counts().allocations, before.allocations);
  EXPECT_EQ(f.navigation_.frame_id(), 1u);
}

}  // namespace navigation_frame_test
}  // namespace godwit::vo
