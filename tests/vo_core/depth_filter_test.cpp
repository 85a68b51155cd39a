#include "vo_core/map/depth_filter.h"

#include <Eigen/QR>
#include <cmath>
#include <gtest/gtest.h>
#include <random>

namespace godwit::vo {
namespace depth_filter_test {

TEST(DepthFilter, ConvergesToTheDepthAmongBadMeasurements) {
  std::mt19937 random(1);
  const double truth = 1.0 / 2.5, tau = 0.02;
  std::normal_distribution<double> good(truth, tau);
  std::uniform_real_distribution<double> bad(0.05, 2.0), coin(0.0, 1.0);
  DepthEstimate e = DepthEstimate::prior(2.0, 0.5);
  const double start = e.relative_sigma();
  for (int i = 0; i < 60; ++i) e.update(coin(random) < 0.3 ? bad(random) : good(random), tau * tau);
  EXPECT_NEAR(e.inv_depth, truth, 0.015);
  EXPECT_LT(e.relative_sigma(), 0.1 * start);
  EXPECT_GT(e.inlier_ratio(), 0.5);
}

TEST(DepthFilter, MeasurementsThatAgreeWithNothingLowerTheInlierRatio) {
  std::mt19937 random(2);
  std::uniform_real_distribution<double> bad(0.02, 2.0);
  DepthEstimate e = DepthEstimate::prior(2.0, 0.5);
  e.variance = 1e-4;
  for (int i = 0; i < 60; ++i) e.update(bad(random), 1e-4);
  EXPECT_LT(e.inlier_ratio(), 0.35);
}

TEST(DepthFilter, NonsenseIsIgnored) {
  DepthEstimate e = DepthEstimate::prior(2.0, 0.5);
  const DepthEstimate before = e;
  e.update(NAN, 1.0);
  e.update(1.0, NAN);
  e.update(INFINITY, 1.0);
  EXPECT_EQ(e.inv_depth, before.inv_depth);
  EXPECT_EQ(e.variance, before.variance);
}

TEST(AgreedDepth, MeasurementsOfOneDepthGiveTheirWeightedMean) {
  AgreedDepth a;
  a.add(1.0, 0.04);
  a.add(1.1, 0.01);
  EXPECT_EQ(a.matches(), 2);
  EXPECT_NEAR(a.inv_depth(), (1.0 / 0.04 + 1.1 / 0.01) / (1.0 / 0.04 + 1.0 / 0.01), 1e-12);
  EXPECT_NEAR(a.variance(), 1.0 / 125.0, 1e-12);
  EXPECT_NEAR(a.relative_sigma(), std::sqrt(a.variance()) / a.inv_depth(), 1e-12);
}

TEST(AgreedDepth, OneThatDisagreesBeginsAnew) {
  AgreedDepth a;
  for (int i = 0; i < 5; ++i) a.add(1.0, 0.01);
  a.add(1.2, 0.01);  // 1.8 sigmas of both together
  EXPECT_EQ(a.matches(), 6);
  a.add(2.0, 0.01);
  EXPECT_EQ(a.matches(), 1);
  EXPECT_EQ(a.inv_depth(), 2.0);
  EXPECT_EQ(a.variance(), 0.01);
}

TEST(AgreedDepth, NonsenseIsLeftOut) {
  AgreedDepth a;
  a.add(1.0, 0.01);
  a.add(NAN, 0.01);
  a.add(1.0, NAN);
  a.add(INFINITY, 1.0);
  a.add(1.0, 0.0);
  a.add(1.0, INFINITY);
  EXPECT_EQ(a.matches(), 1);
}

// The variance against what a match off by one pixel's angle really does to the triangulated inverse depth.
TEST(DepthFilter, MeasurementVarianceFollowsTheGeometry) {
  const double angle = 0.6 / 500.0;
  for (const double baseline : {0.05, 0.2, 0.5}) {
    for (const double depth : {1.0, 3.0}) {
      const Vec3 f = Vec3(0.1, 0.05, 1.0).normalized(), t(baseline, 0, 0);
      const double tau = std::sqrt(inverse_depth_variance(t, f, depth, angle));
      // Ray from the other camera, turned by the angle within the epipolar plane, met with the first ray.
      const Vec3 ray = (f * depth - t).normalized();
      const Vec3 turned = so3_exp(t.cross(f).normalized() * angle) * ray;
      Eigen::Matrix<double, 3, 2> A;
      A << f, -turned;
      const Vec2 s = A.colPivHouseholderQr().solve(t);
      EXPECT_NEAR(tau, std::abs(1.0 / s(0) - 1.0 / depth), 0.15 * tau) << baseline << " " << depth;
    }
  }
}

TEST(DepthFilter, NoBaselineMeansNoInformation) {
  EXPECT_GT(inverse_depth_variance(Vec3::Zero(), Vec3::UnitZ(), 1.0, 1e-3), 1e6);
}

}  // namespace depth_filter_test
}  // namespace godwit::vo
