#include "vo_core/tracking/pose_optimizer.h"

#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <random>
#include <vector>

#include "tests/vo_core/numeric_jacobian.h"
#include "tests/vo_core/test_cameras.h"

namespace godwit::vo {
namespace pose_optimizer_test {

SE3 some_pose() {
  Vec6 x;
  x << 0.2, -0.1, 0.3, 0.05, -0.08, 0.02;
  return SE3::exp(x);
}

std::vector<PoseMeasurement> measure(const CameraModel& camera, const SE3& T, int count, double noise_px,
                                     unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> u(20, camera.width() - 20), v(20, camera.height() - 20), d(1.0, 4.0);
  std::normal_distribution<double> noise(0.0, noise_px);
  std::vector<PoseMeasurement> out;
  while (static_cast<int>(out.size()) < count) {
    const Vec2 px(u(random), v(random));
    PoseMeasurement m;
    m.p_world = T.inverse() * (camera.unproject(px) * d(random));
    m.px = px + Vec2(noise(random), noise(random));
    m.gradient = Vec2(0.6, 0.8);
    out.push_back(m);
  }
  return out;
}

TEST(PoseOptimizer, JacobianAgreesWithDifferences) {
  const CameraModel camera = test::tum_fr1();
  const SE3 T = some_pose();
  for (FeatureType type : {FeatureType::kCorner, FeatureType::kEdgelet}) {
    for (PoseMeasurement m : measure(camera, T, 20, 2.0, 1)) {
      m.type = type;
      Vec2 r;
      Mat26 J;
      ASSERT_TRUE(pose_residual(camera, T, m, &r, &J));
      const auto moved = [&](const Vec6& x) {
        Vec2 there = Vec2::Zero();
        EXPECT_TRUE(pose_residual(camera, SE3::exp(x) * T, m, &there, nullptr));
        return there;
      };
      EXPECT_TRUE(test::agrees(J, test::numeric_jacobian<6>(moved)));
    }
  }
}

TEST(PoseOptimizer, FindsThePoseAmongOutliers) {
  const CameraModel camera = test::tum_fr1();
  const SE3 truth = some_pose();
  std::vector<PoseMeasurement> m = measure(camera, truth, 120, 0.3, 2);
  for (PoseMeasurement& x : m) x.sigma_px = 0.3;
  for (int i = 0; i < 36; ++i) m[static_cast<std::size_t>(i)].px += Vec2(15 + i, -20);
  SE3 T = SE3::exp((Vec6() << 0.02, -0.01, 0.02, 0.01, 0.005, -0.01).finished()) * truth;
  const PoseOptimizerResult r = optimize_pose(camera, {}, m, &T);
  ASSERT_TRUE(r.ok);
  EXPECT_GE(r.inliers, 80);
  for (int i = 0; i < 36; ++i) EXPECT_FALSE(m[static_cast<std::size_t>(i)].inlier);
  EXPECT_LT((T * truth.inverse()).log().head<3>().norm(), 0.003);
  EXPECT_LT((T * truth.inverse()).log().tail<3>().norm(), 0.002);
}

/// Normalised estimation error squared over many draws, 6 where the covariance is true, and the mean of sigma_scale.
Vec2 mean_nees_and_scale(double noise_px, int edgelets_of_ten) {
  const CameraModel camera = test::euroc();
  const SE3 truth = some_pose();
  Vec2 sum = Vec2::Zero();
  const int runs = 200;
  for (int i = 0; i < runs; ++i) {
    std::vector<PoseMeasurement> m = measure(camera, truth, 120, noise_px, static_cast<unsigned>(100 + i));
    for (std::size_t k = 0; k < m.size(); ++k) {
      m[k].sigma_px = noise_px;
      const double angle = 0.7 * static_cast<double>(k);
      m[k].gradient = Vec2(std::cos(angle), std::sin(angle));
      if (static_cast<int>(k % 10) < edgelets_of_ten) m[k].type = FeatureType::kEdgelet;
    }
    SE3 T = truth;
    const PoseOptimizerResult r = optimize_pose(camera, {}, m, &T);
    EXPECT_TRUE(r.ok);
    EXPECT_LT(r.chi_square, chi_square_limit(r.freedom));
    const Vec6 e = (T * truth.inverse()).log();
    sum += Vec2(e.dot(r.covariance.inverse() * e), r.sigma_scale);
  }
  return sum / runs;
}

TEST(PoseOptimizer, CovarianceIsWhatTheErrorsAre) {
  // The robust weights cost a few per cent of efficiency.
  const Vec2 corners = mean_nees_and_scale(0.5, 0), edgelets = mean_nees_and_scale(0.5, 10),
             both = mean_nees_and_scale(0.5, 6);
  for (const Vec2& mean : {corners, edgelets, both}) {
    EXPECT_GT(mean.x(), 4.5);
    EXPECT_LT(mean.x(), 9.0);
    // An edgelet has one coordinate, a corner two: each by the median of its own.
    EXPECT_NEAR(mean.y(), 1.0, 0.1);
  }
}

/// Measurements of points about one metre away, all in one corner of the picture, and all but in a plane.
std::vector<PoseMeasurement> in_a_corner(const CameraModel& camera, const SE3& T, int count, double noise_px,
                                         unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> u(430, 530), v(250, 310), d(0.98, 1.02);
  std::normal_distribution<double> noise(0.0, noise_px);
  std::vector<PoseMeasurement> out(static_cast<std::size_t>(count));
  for (PoseMeasurement& m : out) {
    const Vec2 px(u(random), v(random));
    m.p_world = T.inverse() * (camera.unproject(px) * d(random));
    m.px = px + Vec2(noise(random), noise(random));
    m.sigma_px = noise_px;
  }
  return out;
}

PosePrediction prediction(const SE3& T, double place, double turn) {
  PosePrediction p;
  p.known = true;
  p.T_cam_world = T;
  p.information.diagonal() << Vec3::Constant(1.0 / (place * place)), Vec3::Constant(1.0 / (turn * turn));
  return p;
}

TEST(PoseOptimizer, HowTheCameraMovesTellsAStepFromATurn) {
  const CameraModel camera = test::tum_fr1();
  const SE3 truth = some_pose();
  constexpr double kPlace = 0.004, kTurn = 0.004;
  std::mt19937 random(9);
  std::normal_distribution<double> normal;
  double alone2 = 0.0, together2 = 0.0, nees = 0.0;
  constexpr int kRuns = 200;
  for (int i = 0; i < kRuns; ++i) {
    std::vector<PoseMeasurement> m = in_a_corner(camera, truth, 60, 0.5, static_cast<unsigned>(i));
    SE3 alone = truth, together = truth;
    ASSERT_TRUE(optimize_pose(camera, {}, m, &alone).ok);
    Vec6 x;
    for (int k = 0; k < 6; ++k) x(k) = (k < 3 ? kPlace : kTurn) * normal(random);
    const PoseOptimizerResult r =
        optimize_pose(camera, {}, m, &together, prediction(SE3::exp(x) * truth, kPlace, kTurn));
    ASSERT_TRUE(r.ok);
    const Vec6 e = (together * truth.inverse()).log();
    alone2 += (alone * truth.inverse()).log().head<3>().squaredNorm();
    together2 += e.head<3>().squaredNorm();
    nees += e.dot(r.with_prior.inverse() * e);
  }
  EXPECT_GT(std::sqrt(alone2 / kRuns), 0.012) << "[m] the corner alone";
  EXPECT_LT(std::sqrt(together2 / kRuns), 0.005);
  // Measurements and prior together are as sure as they say.
  EXPECT_GT(nees / kRuns, 4.5);
  EXPECT_LT(nees / kRuns, 7.5);
}

TEST(PoseOptimizer, WhereThePictureTellsThePoseThePriorHardlyCounts) {
  // Three of its sigmas off, as a camera that is pushed.
  const CameraModel camera = test::euroc();
  const SE3 truth = some_pose();
  std::vector<PoseMeasurement> m = measure(camera, truth, 120, 0.3, 2);
  for (PoseMeasurement& x : m) x.sigma_px = 0.3;
  SE3 alone = truth, together = truth;
  const Vec6 off = (Vec6() << 0.03, 0, 0, 0, 0.015, 0).finished();
  ASSERT_TRUE(optimize_pose(camera, {}, m, &alone).ok);
  ASSERT_TRUE(optimize_pose(camera, {}, m, &together, prediction(SE3::exp(off) * truth, 0.01, 0.005)).ok);
  EXPECT_LT((together * alone.inverse()).log().norm(), 0.02 * off.norm());
}

TEST(PoseOptimizer, MeasurementsThatErrTogetherWeighLessBesideThePrior) {
  const CameraModel camera = test::tum_fr1();
  const SE3 truth = some_pose();
  std::vector<PoseMeasurement> m = in_a_corner(camera, truth, 60, 0.5, 1);
  PosePrediction prior = prediction(truth, 0.004, 0.004);
  SE3 one_by_one = truth, together = truth;
  const PoseOptimizerResult sure = optimize_pose(camera, {}, m, &one_by_one, prior);
  prior.correlated = 25.0;
  const PoseOptimizerResult unsure = optimize_pose(camera, {}, m, &together, prior);
  ASSERT_TRUE(sure.ok && unsure.ok);
  EXPECT_LT((together * truth.inverse()).log().norm(), (one_by_one * truth.inverse()).log().norm());
  EXPECT_GT(unsure.with_prior.trace(), sure.with_prior.trace());
}

// The sums are taken several measurements at a time; the Jacobian of one is held against differences above.
TEST(PoseOptimizer, InformationIsTheSumOfTheMeasurementsOwn) {
  for (const CameraModel& camera : {test::tum_fr1(), test::fisheye()}) {
    std::vector<PoseMeasurement> m = measure(camera, some_pose(), 61, 0.5, 7);
    for (std::size_t i = 0; i < m.size(); ++i) {
      m[i].sigma_px = 0.4 + 0.1 * static_cast<double>(i % 5);
      if (i % 3 == 0) m[i].type = FeatureType::kEdgelet;
    }
    m[4].p_world = some_pose().inverse() * Vec3(0.1, 0.2, -1.0);  // behind the camera
    m[9].p_world = Vec3::Constant(std::numeric_limits<double>::quiet_NaN());
    SE3 T = some_pose();
    const PoseOptimizerResult result = optimize_pose(camera, {}, m, &T);
    ASSERT_TRUE(result.ok);
    EXPECT_FALSE(m[4].inlier);
    EXPECT_FALSE(m[9].inlier);
    Mat6 H = Mat6::Zero();
    double chi_square = 0.0;
    for (const PoseMeasurement& x : m) {
      Vec2 r;
      Mat26 J;
      if (!x.inlier) continue;
      ASSERT_TRUE(pose_residual(camera, T, x, &r, &J));
      H += J.transpose() * J / (x.sigma_px * x.sigma_px);
      chi_square += r.squaredNorm() / (x.sigma_px * x.sigma_px);
    }
    EXPECT_NEAR(result.chi_square, chi_square, 1e-6 * chi_square);
    const Mat6 covariance = H.inverse() * std::max(1.0, chi_square / result.freedom);
    EXPECT_LT((result.covariance - covariance).norm(), 1e-6 * covariance.norm());
  }
}

TEST(PoseOptimizer, ChiSquareLimitIsThatOfTheTables) {
  EXPECT_NEAR(chi_square_limit(10), 29.588, 0.3);
  EXPECT_NEAR(chi_square_limit(100), 149.449, 0.1);
  EXPECT_NEAR(chi_square_limit(300), 381.425, 0.2);
}

TEST(PoseOptimizer, NoiseTwiceTheStatedIsSeen) {
  const CameraModel camera = test::euroc();
  std::vector<PoseMeasurement> m = measure(camera, some_pose(), 150, 0.8, 5);
  for (PoseMeasurement& x : m) x.sigma_px = 0.4;
  SE3 T = some_pose();
  const PoseOptimizerResult r = optimize_pose(camera, {}, m, &T);
  ASSERT_TRUE(r.ok);
  EXPECT_GT(r.chi_square, chi_square_limit(r.freedom));
  EXPECT_NEAR(r.sigma_scale, 2.0, 0.3);
}

// What an alignment gives that finds nothing: offsets anywhere within the 4 px that it may move.
TEST(PoseOptimizer, OffsetsByChanceDoNotAgreeWithAnyPose) {
  const CameraModel camera = test::euroc();
  for (unsigned seed = 0; seed < 10; ++seed) {
    std::vector<PoseMeasurement> m = measure(camera, some_pose(), 150, 0.0, 20 + seed);
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> u(-4.0, 4.0);
    for (PoseMeasurement& x : m) {
      x.sigma_px = 0.45;
      Vec2 off;
      do off = Vec2(u(random), u(random));
      while (off.norm() > 4.0);
      x.px += off;
    }
    SE3 T = some_pose();
    const PoseOptimizerResult r = optimize_pose(camera, {}, m, &T);
    EXPECT_LT(r.inliers, 150 * 3 / 10) << seed;
  }
}

TEST(PoseOptimizer, RefusesTooFewMeasurementsAndLeavesThePose) {
  const CameraModel camera = test::euroc();
  std::vector<PoseMeasurement> m = measure(camera, some_pose(), 9, 0.1, 3);
  SE3 T;
  EXPECT_FALSE(optimize_pose(camera, {}, m, &T).ok);
  EXPECT_EQ(T.t, Vec3::Zero().eval());
}

TEST(PoseOptimizer, BesideAPriorFewerMeasurementsWillDo) {
  const CameraModel camera = test::euroc();
  const SE3 truth = some_pose();
  for (const int count : {5, 8}) {
    std::vector<PoseMeasurement> m = measure(camera, truth, count, 0.1, 3);
    const SE3 predicted = SE3::exp((Vec6() << 0.004, 0, 0, 0, 0.004, 0).finished()) * truth;
    SE3 T = predicted;
    const PoseOptimizerResult r = optimize_pose(camera, {}, m, &T, prediction(predicted, 0.01, 0.01));
    EXPECT_EQ(r.ok, count == 8);
    if (!r.ok) continue;
    EXPECT_LT((T * truth.inverse()).log().norm(), 0.002);
  }
}

TEST(PoseOptimizer, RefusesMeasurementsThatFitNoPose) {
  const CameraModel camera = test::euroc();
  std::vector<PoseMeasurement> m = measure(camera, some_pose(), 40, 0.0, 4);
  for (PoseMeasurement& x : m) x.p_world = Vec3(0, 0, -5);  // behind the camera
  SE3 T;
  EXPECT_FALSE(optimize_pose(camera, {}, m, &T).ok);
}

}  // namespace pose_optimizer_test
}  // namespace godwit::vo
