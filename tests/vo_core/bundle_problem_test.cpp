// Residuals of map points and the normal equations made of them, against differences.
#include "vo_core/map/bundle_problem.h"

#include <gtest/gtest.h>
#include <memory>

#include "tests/vo_core/bundle_world.h"
#include "tests/vo_core/numeric_jacobian.h"
#include "vo_core/map/structure_optimizer.h"

namespace godwit::vo {
namespace bundle_problem_test {

using test::BundleWorld;

TEST(Reprojection, DerivativesAreThoseOfDifferences) {
  const SE3 T = SE3::exp((Vec6() << 0.2, -0.1, 0.3, 0.05, -0.08, 0.02).finished());
  for (const CameraModel& camera : {test::tum_fr1(), test::euroc(), test::fisheye()}) {
    for (const bool edgelet : {false, true}) {
      for (const Vec2& at : {Vec2(30, 40), Vec2(320, 240), Vec2(600, 60), Vec2(50, 440)}) {
        const ImageObservation seen{at + Vec2(1.5, -0.5), Vec2(0.6, 0.8), 0.25, edgelet};
        const Vec3 p = T.inverse() * (2.3 * camera.unproject(at));
        const auto residual = [&](const SE3& pose, const Vec3& point) {
          Vec2 r = Vec2::Zero();
          EXPECT_TRUE(reprojection_residual(camera, seen, pose, point, &r));
          return r;
        };
        Vec2 r = Vec2::Zero();
        Mat23 J_point = Mat23::Zero();
        Mat26 J_pose = Mat26::Zero();
        ASSERT_TRUE(reprojection_residual(camera, seen, T, p, &r, &J_point, &J_pose));
        EXPECT_EQ(r, residual(T, p)) << "with derivatives or without";
        EXPECT_TRUE(test::agrees((-J_point).eval(),
                                 test::numeric_jacobian<3>([&](const Vec3& d) { return residual(T, p + d); })));
        EXPECT_TRUE(test::agrees(
            (-J_pose).eval(), test::numeric_jacobian<6>([&](const Vec6& x) { return residual(SE3::exp(x) * T, p); })));
      }
    }
  }
}

using Value = Eigen::Matrix<double, 1, 1>;

// All of it at once: selection, weights within Huber's limit and beyond, edgelets, levels, fixed keyframes.
TEST(BundleProblem, RightHandSidesAreTheGradientOfTheCost) {
  BundleWorld w(0.8, 4);
  w.disturb();
  for (int k = 0; k < 6; ++k)
    for (int i = 0; i < w.map.keyframe(k).feature_count; i += 3)
      w.map.keyframe(k).features[static_cast<std::size_t>(i)].level = static_cast<std::int8_t>(i % 4);
  BundleAdjusterOptions options;
  options.max_free_keyframes = 3;
  auto s = std::make_unique<BundleProblem>(w.camera, options);
  s->select(w.map, 5);
  ASSERT_EQ(s->free_count, 3);
  ASSERT_EQ(s->pose_count, 6);
  const double cost = s->linearize();
  EXPECT_NEAR(cost, s->cost(s->pose, false), 1e-9 * cost);
  int within = 0, beyond = 0;
  for (int i = 0; i < s->obs_count; ++i) ++(s->obs[i].error.norm() < options.huber_px ? within : beyond);
  EXPECT_GT(within, 50);
  EXPECT_GT(beyond, 50);
  for (std::size_t f = 0; f < 3; ++f) {
    const auto moved = [&](const Vec6& x) {
      auto poses = s->pose;
      poses[f] = SE3::exp(x) * poses[f];
      return Value(s->cost(poses, false));
    };
    EXPECT_TRUE(test::agrees((-2.0 * s->bp[f].transpose()).eval(), test::numeric_jacobian<6>(moved), 1e-5)) << f;
  }
  for (std::size_t i = 0; i < 12; ++i) {
    BundleProblem::Point& q = s->points[i];
    const auto moved = [&](const Vec3& d) {
      const Vec3 p = q.p;
      q.p += d;
      const Value out(s->cost(s->pose, false));
      q.p = p;
      return out;
    };
    // Differences of the whole cost, to which one point gives little.
    EXPECT_TRUE(test::agrees((-2.0 * q.b.transpose()).eval(), test::numeric_jacobian<3>(moved), 1e-4)) << i;
  }
}

// The products of the derivatives: second differences of the cost where everything fits and Huber's weights are one.
TEST(BundleProblem, MatricesAreHalfTheSecondDifferencesWhereTheMapFits) {
  BundleWorld w(0.0, 4);
  auto s = std::make_unique<BundleProblem>(w.camera, BundleAdjusterOptions{});
  s->select(w.map, 5);
  s->linearize();
  BundleProblem::Point& q = s->points[7];
  int j = q.first;
  while (s->obs[static_cast<std::size_t>(j)].pose != 1) ++j;
  const Mat63 H_pose_point = s->obs[static_cast<std::size_t>(j)].Hpl;
  const Mat6 H_pose = s->Hpp[1];
  const Mat3 H_point = q.H;
  const SE3 T = s->pose[1];
  const Vec3 p = q.p;
  // Gradients at displaced places, which the test above has proved.
  const auto by_pose = test::numeric_jacobian<6>([&](const Vec6& x) {
    s->pose[1] = SE3::exp(x) * T;
    s->linearize();
    s->pose[1] = T;
    return Vec6(-s->bp[1]);
  });
  EXPECT_TRUE(test::agrees(H_pose, by_pose, 1e-4));
  const auto by_point = test::numeric_jacobian<3>([&](const Vec3& d) {
    q.p = p + d;
    s->linearize();
    q.p = p;
    Eigen::Matrix<double, 9, 1> out;
    out << -s->bp[1], -q.b;
    return out;
  });
  EXPECT_TRUE(test::agrees(H_pose_point, by_point.topRows<6>().eval(), 1e-4));
  EXPECT_TRUE(test::agrees(H_point, by_point.bottomRows<3>().eval(), 1e-4));
}

// Structure optimisation ends where the differences of the squared errors vanish.
TEST(StructureOptimizer, EndsWhereTheCostHasNoSlope) {
  BundleWorld w(0.5);
  for (int i = 0; i < 150; i += 13) {
    const MapPoint& point = w.map.point(i);
    if (point.observation_count < 4) continue;
    Vec3 p = point.p_world * 1.02;
    ASSERT_GE(optimize_structure(w.camera, w.map, point, 15, &p), 0.0);
    const auto cost = [&](const Vec3& d) {
      double sum = 0.0;
      for (int k = 0; k < point.observation_count; ++k) {
        const Keyframe& kf = w.map.keyframe(point.observations[static_cast<std::size_t>(k)].keyframe);
        const KeyframeFeature& f = kf.features[point.observations[static_cast<std::size_t>(k)].feature];
        const ImageObservation seen{f.px_global.cast<double>(), f.gradient.cast<double>(), 1.0 / (1 << f.level),
                                    f.type == FeatureType::kEdgelet};
        Vec2 r = Vec2::Zero();
        EXPECT_TRUE(reprojection_residual(w.camera, seen, kf.T_kf_world, p + d, &r));
        sum += r.squaredNorm();
      }
      return Value(sum);
    };
    const auto slope = test::numeric_jacobian<3>(cost);
    // A thousandth of the distance away the cost has a slope.
    const Vec3 away = 0.001 * p;
    const auto slope_beside = test::numeric_jacobian<3>([&](const Vec3& d) { return cost(away + d); });
    EXPECT_LT(slope.norm(), 0.01 * slope_beside.norm() + 1e-3) << i;
  }
}

}  // namespace bundle_problem_test
}  // namespace godwit::vo
