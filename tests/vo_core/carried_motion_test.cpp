// What goes on from a picture until the next one: where it begins it is what was told, where it ends the next picture
// finds it within its covariance, and in between the truth is.
#include "vo_core/inertial/carried_motion.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <gtest/gtest.h>

#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"
#include "tests/vo_core/navigation_flown.h"

namespace godwit::vo {
namespace carried_motion_test {

using test::NavigationFlown;

template <int N>
double squared(const Eigen::Matrix<double, N, 1>& e, const Eigen::Matrix<double, N, N>& C) {
  return e.dot(C.llt().solve(e));
}

/// From the pose that was told to the camera's, both along the frame's axes.
Vec6 apart(const SE3& to, const SE3& from) {
  Vec6 e;
  e << to.t - from.t, so3_log(to.R * from.R.transpose());
  return e;
}

TEST(CarriedMotion, WhereItBeginsItIsWhatWasToldSeenOrCoasted) {
  ImuBuffer readings;
  NavigationFlown f(1);
  f.readings_ = &readings;
  for (int k = 0; k < 60; ++k) {
    const NavigationPose told = f.frame(k, k < 40);
    ASSERT_NE(told.source, NavigationPose::Source::kNone);
    const Motion motion = f.navigation_.motion();
    ASSERT_TRUE(motion.known);
    CameraMotion camera;
    ASSERT_TRUE(carry(motion, motion.t_sensor_ns, readings, {}, &camera));
    EXPECT_LT(apart(camera.T_nav_cam, told.T_nav_cam).norm(), 1e-9);
    EXPECT_LT((camera.velocity_m_s - told.velocity_m_s).norm(), 1e-9);
    EXPECT_LT((camera.covariance - told.covariance).norm(), 1e-12 + 1e-9 * told.covariance.norm());
    EXPECT_LT((camera.velocity_covariance - told.velocity_covariance).norm(), 1e-12);
  }
}

TEST(CarriedMotion, TheNextPictureFindsItWithinItsCovarianceAndTheTruthIsInBetween) {
  double jumps = 0, speed_jumps = 0, between = 0, worst = 0;
  int n = 0, m = 0;
  for (unsigned seed = 1; seed <= 30; ++seed) {
    ImuBuffer readings;
    NavigationFlown f(seed);
    f.readings_ = &readings;
    f.frame(0);
    for (int k = 1; k < 100; ++k) {
      const Motion motion = f.navigation_.motion();
      const NavigationPose next = f.frame(k);
      CameraMotion camera;
      for (int i = 1; i < 10; ++i) {
        const rt::TimeNs t_ns = NavigationFlown::time(k - 1) + i * 5 * rt::kNsPerMs;
        ASSERT_TRUE(carry(motion, t_ns, readings, {}, &camera));
        between += squared<6>(f.error_at(rt::to_seconds(t_ns), camera.T_nav_cam), camera.covariance) / 6;
        ++m;
      }
      ASSERT_TRUE(carry(motion, NavigationFlown::time(k), readings, {}, &camera));
      // Here each picture's errors are its own, so that the jump has those of both.
      const double jump = squared<6>(apart(next.T_nav_cam, camera.T_nav_cam), camera.covariance + next.covariance);
      jumps += jump / 6;
      worst = std::max(worst, jump);
      speed_jumps +=
          squared<3>(next.velocity_m_s - camera.velocity_m_s, camera.velocity_covariance + next.velocity_covariance) /
          3;
      ++n;
    }
  }
  std::printf("jumps: NEES %.2f, speed %.2f, the worst of %d %.1f; between pictures %.2f\n", jumps / n, speed_jumps / n,
              n, worst, between / m);
  EXPECT_GT(jumps / n, 0.7);
  EXPECT_LT(jumps / n, 1.3);
  EXPECT_GT(speed_jumps / n, 0.7);
  EXPECT_LT(speed_jumps / n, 1.3);
  EXPECT_GT(between / m, 0.7);
  EXPECT_LT(between / m, 1.3);
  EXPECT_LT(worst, 33) << "by chance six degrees of freedom exceed this once in 100,000 times";
}

TEST(CarriedMotion, TheFurtherTheLessCertain) {
  ImuBuffer readings;
  NavigationFlown f(2);
  f.readings_ = &readings;
  for (int k = 0; k < 20; ++k) f.frame(k);
  const Motion motion = f.navigation_.motion();
  for (int k = 20; k < 24; ++k) f.feel(k);
  double last = 0;
  for (int i = 0; i < 40; ++i) {
    CameraMotion camera;
    ASSERT_TRUE(carry(motion, motion.t_sensor_ns + i * 5 * rt::kNsPerMs, readings, {}, &camera));
    EXPECT_GT(camera.covariance.trace(), last);
    last = camera.covariance.trace();
  }
}

TEST(CarriedMotion, NobodyGoesOnWithoutReadings) {
  ImuBuffer readings;
  NavigationFlown f(3);
  f.readings_ = &readings;
  CameraMotion camera;
  EXPECT_FALSE(f.navigation_.motion().known) << "nothing was seen yet";
  EXPECT_FALSE(carry({}, 0, readings, {}, &camera));
  for (int k = 0; k < 20; ++k) f.frame(k);
  const Motion motion = f.navigation_.motion();
  EXPECT_FALSE(carry(motion, motion.t_sensor_ns - 1, readings, {}, &camera)) << "back";
  EXPECT_FALSE(carry(motion, motion.t_sensor_ns + 40 * rt::kNsPerMs, readings, {}, &camera))
      << "beyond the last reading";
  f.silent_ = true;
  f.frame(20, false);
  f.frame(21, false);
  EXPECT_FALSE(f.navigation_.motion().known) << "nobody measured since";
}

TEST(CarriedMotion, DoesNotAllocate) {
  ImuBuffer readings;
  NavigationFlown f(4);
  f.readings_ = &readings;
  for (int k = 0; k < 20; ++k) f.frame(k);
  const rt::HeapCounts before = rt::rt_heap_counts();
  {
    const rt::RtScope real_time;
    const Motion motion = f.navigation_.motion();
    f.feel(20);
    CameraMotion camera;
    EXPECT_TRUE(carry(motion, NavigationFlown::time(20), readings, {}, &camera));
  }
  EXPECT_EQ(rt::rt_heap_counts().allocations, before.allocations);
}

}  // namespace carried_motion_test
}  // namespace godwit::vo
