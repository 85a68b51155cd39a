#include "vo_core/bundle_adjuster.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <cmath>
#include <gtest/gtest.h>
#include <memory>
#include <random>
#include <vector>

#include "tests/vo_core/test_cameras.h"
#include "vo_core/structure_optimizer.h"

namespace godwit::vo {
namespace {

// Six keyframes along a line look at 150 points.
struct World {
  CameraModel camera = test::euroc();
  Map map;
  std::vector<Vec3> points;
  std::vector<SE3> poses;

  /// Of ten points so many are edgelets, measured along one direction only; across it they may be off by any amount.
  explicit World(double noise_px, int edgelets_of_ten = 0, unsigned seed = 5) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> xy(-1.0, 1.0), z(1.5, 4.0);
    std::normal_distribution<double> noise(0.0, noise_px);
    for (int i = 0; i < 150; ++i) {
      const double d = z(random);
      points.emplace_back(xy(random) * 0.6 * d, xy(random) * 0.4 * d, d);
    }
    for (int k = 0; k < 6; ++k) {
      poses.push_back(SE3::exp((Vec6() << -0.1 * k, 0.02 * k, 0.01 * k, 0.0, 0.01 * k, 0.0).finished()));
      Keyframe& kf = map.insert_keyframe(k, static_cast<std::uint32_t>(k + 1));
      kf.T_kf_world = poses.back();
    }
    for (std::size_t i = 0; i < points.size(); ++i) {
      const PointHandle h = map.free_point();
      map.activate_point(h, points[i]);
      for (int k = 0; k < 6; ++k) {
        Vec2 px;
        if (!camera.project(poses[static_cast<std::size_t>(k)] * points[i], &px) || !camera.in_image(px, 5)) continue;
        KeyframeFeature f;
        f.px = f.px_global = (px + Vec2(noise(random), noise(random))).cast<float>();
        f.bearing = camera.unproject(px);
        f.point = h;
        if (static_cast<int>(i % 10) < edgelets_of_ten) {
          f.type = FeatureType::kEdgelet;
          // The world's edge is one and the same; here the views hardly roll, and neither does its normal.
          f.gradient = i % 2 == 0 ? Vec2f(1.0f, 0.0f) : Vec2f(0.8f, 0.6f);
          f.px_global += 3.0f * static_cast<float>(k) * Vec2f(-f.gradient.y(), f.gradient.x());
        }
        map.append_feature(k, f);
      }
    }
  }

  void disturb() {
    std::mt19937 random(6);
    std::normal_distribution<double> t(0.0, 0.01), r(0.0, 0.004), p(0.0, 0.05);
    for (int k = 2; k < 6; ++k)
      map.keyframe(k).T_kf_world =
          SE3::exp((Vec6() << t(random), t(random), t(random), r(random), r(random), r(random)).finished()) *
          map.keyframe(k).T_kf_world;
    for (int i = 0; i < map.point_end(); ++i) map.point(i).p_world += Vec3(p(random), p(random), p(random));
  }

  double pose_error() const {
    // Scale is free: compare directions of the motion and rotations.
    double worst = 0.0;
    for (int k = 1; k < 6; ++k) {
      const SE3& a = map.keyframe(k).T_kf_world;
      worst = std::max(worst, so3_log(a.R * poses[static_cast<std::size_t>(k)].R.transpose()).norm());
      const Vec3 c = map.keyframe(k).position().normalized();
      const Vec3 truth = (poses[static_cast<std::size_t>(k)].inverse().t).normalized();
      worst = std::max(worst, std::acos(std::min(1.0, c.dot(truth))));
    }
    return worst;
  }
};

TEST(BundleAdjuster, BringsADisturbedMapBack) {
  World w(0.2);
  w.disturb();
  const double before = w.pose_error();
  BundleAdjusterOptions options;
  options.max_iterations = 10;
  BundleAdjuster bundle(w.camera, options);
  const BundleReport r = bundle.run(&w.map, 5);
  EXPECT_EQ(r.free_keyframes, 5);
  EXPECT_EQ(r.fixed_keyframes, 1);
  EXPECT_LT(r.rms_after_px, 0.35);
  EXPECT_LT(r.rms_after_px, 0.2 * r.rms_before_px);
  EXPECT_LT(w.pose_error(), 0.2 * before);
  EXPECT_EQ(w.map.keyframe(0).T_kf_world.t, w.poses[0].t) << "the first keyframe holds the gauge";
}

TEST(BundleAdjuster, EdgeletsCountAcrossTheirEdgeAlone) {
  World w(0.2, 5);
  w.disturb();
  const double before = w.pose_error();
  BundleAdjusterOptions options;
  options.max_iterations = 12;
  BundleAdjuster bundle(w.camera, options);
  const BundleReport r = bundle.run(&w.map, 5);
  EXPECT_LT(r.rms_after_px, 0.35) << "what they are off along the edge is no error";
  EXPECT_LT(w.pose_error(), 0.25 * before);
  EXPECT_EQ(r.outliers, 0);
}

// With derivatives as they should be, Gauss-Newton on measurements without noise at least squares the error in each
// step; with wrong ones it would shrink by a factor.
TEST(BundleAdjuster, ConvergesAsOnlyTrueDerivativesLetIt) {
  for (const int edgelets : {0, 5}) {
    World w(0.0, edgelets);
    std::mt19937 random(8);
    std::normal_distribution<double> r(0.0, 0.002);
    for (int k = 1; k < 6; ++k)
      w.map.keyframe(k).T_kf_world =
          SE3::exp((Vec6() << r(random), r(random), r(random), r(random), r(random), r(random)).finished()) *
          w.map.keyframe(k).T_kf_world;
    BundleAdjusterOptions options;
    options.max_iterations = 1;
    BundleAdjuster bundle(w.camera, options);
    bundle.run(&w.map, 5);
    const double once = bundle.run(&w.map, 5).rms_before_px;
    const BundleReport last = bundle.run(&w.map, 5);
    EXPECT_LT(once, 0.1) << edgelets;
    EXPECT_LT(last.rms_before_px, 0.02 * once + 5e-4) << edgelets << ", after one step " << once;
  }
}

TEST(BundleAdjuster, ReportsWrongObservations) {
  World w(0.2);
  for (int i = 0; i < 8; ++i) w.map.keyframe(3).features[static_cast<std::size_t>(5 * i)].px_global += Vec2f(12, -9);
  BundleAdjuster bundle(w.camera, {});
  bundle.run(&w.map, 5);
  int found = 0;
  for (int i = 0; i < bundle.outlier_count(); ++i) {
    EXPECT_EQ(bundle.outlier(i).keyframe, 3);
    found += bundle.outlier(i).feature % 5 == 0 && bundle.outlier(i).feature < 40;
  }
  EXPECT_EQ(found, 8);
}

TEST(BundleAdjuster, AnEmptyMapIsLeftAlone) {
  World w(0.0);
  w.map.clear();
  w.map.insert_keyframe(0, 1);
  BundleAdjuster bundle(w.camera, {});
  EXPECT_EQ(bundle.run(&w.map, 0).observations, 0);
  EXPECT_EQ(bundle.moved_point_count(), 0);
}

TEST(StructureOptimizer, EdgeletsCountAcrossTheirEdgeAlone) {
  World w(0.0, 10);
  const MapPoint& p = w.map.point(7);
  Vec3 guess = p.p_world + Vec3(0.05, -0.04, 0.3);
  EXPECT_LT(optimize_structure(w.camera, w.map, p, 10, &guess), 1e-3);
}

// One step less and one step more: the error is squared by each.
TEST(StructureOptimizer, ConvergesAsOnlyTrueDerivativesLetIt) {
  World w(0.0);
  for (int i = 0; i < 150; i += 10) {
    const MapPoint& p = w.map.point(i);
    if (p.observation_count < 4) continue;
    Vec3 one = w.points[static_cast<std::size_t>(i)] * 1.03, two = one, three = one;
    const double first = optimize_structure(w.camera, w.map, p, 1, &one);
    const double second = optimize_structure(w.camera, w.map, p, 2, &two);
    const double third = optimize_structure(w.camera, w.map, p, 3, &three);
    EXPECT_LT(first, 0.5) << i;
    EXPECT_LT(second, 0.05 * first + 1e-4) << i;
    EXPECT_LT(third, 0.05 * second + 1e-4) << i;
  }
}

TEST(StructureOptimizer, FindsTheMiddleOfItsObservations) {
  World w(0.0);
  const MapPoint& p = w.map.point(7);
  Vec3 guess = p.p_world + Vec3(0.05, -0.04, 0.3);
  const double rms = optimize_structure(w.camera, w.map, p, 10, &guess);
  EXPECT_LT(rms, 1e-3);
  EXPECT_LT((guess - w.points[7]).norm(), 1e-3);
}

// Many worlds, adjusted: how far the newest keyframe is off relative to each other one, against what is told.
TEST(BundleAdjuster, TellsHowCertainTheCentreIs) {
  double squared = 0.0;
  int freedom = 0;
  for (unsigned seed = 1; seed <= 40; ++seed) {
    auto w = std::make_unique<World>(0.3, 0, seed);
    BundleAdjusterOptions options;
    options.max_iterations = 6;
    BundleAdjuster bundle(w->camera, options);
    ASSERT_EQ(bundle.run(&w->map, 5).free_keyframes, 5);
    MapShares shares;
    bundle.shares(w->map, &shares);
    ASSERT_EQ(shares.centre, 6u);
    ASSERT_EQ(shares.count, 6);
    ASSERT_EQ(shares.share[0].keyframe_id, 6u) << "first what the centre's own noise makes of it";
    const SE3& T_n = w->map.keyframe(5).T_kf_world;
    for (int i = 1; i < shares.count; ++i) {
      const MapShare& share = shares.share[static_cast<std::size_t>(i)];
      const int k = static_cast<int>(share.keyframe_id) - 1;
      // Own noise and the map's share make the whole.
      const Mat6 C = shares.share[0].covariance + share.covariance;
      EXPECT_GE(share.covariance.selfadjointView<Eigen::Lower>().eigenvalues().minCoeff(), -1e-9 * C.norm());
      const SE3 told = T_n * w->map.keyframe(k).T_kf_world.inverse();
      const SE3 truth = w->poses[5] * w->poses[static_cast<std::size_t>(k)].inverse();
      // Rotation, and direction of the keyframe seen from the centre: how long the way is, one camera cannot know.
      const Vec3 d = told.t.normalized(), first = d.unitOrthogonal(), second = d.cross(first);
      Eigen::Matrix<double, 5, 1> error;
      error.head<3>() = so3_log(truth.R * told.R.transpose());
      error.tail<2>() << first.dot(truth.t.normalized()), second.dot(truth.t.normalized());
      Eigen::Matrix<double, 2, 3> B;
      B << first.transpose(), second.transpose();
      Eigen::Matrix<double, 5, 6> J = Eigen::Matrix<double, 5, 6>::Zero();
      J.topRightCorner<3, 3>().setIdentity();
      J.bottomLeftCorner<2, 3>() = B / told.t.norm();
      J.bottomRightCorner<2, 3>() = -B * skew(d);
      const Eigen::Matrix<double, 5, 5> P = J * C * J.transpose();
      squared += error.dot(P.ldlt().solve(error));
      freedom += 5;
    }
  }
  EXPECT_NEAR(squared / freedom, 1.0, 0.3);
}

}  // namespace
}  // namespace godwit::vo
