#include "vo_core/map/bundle_adjuster.h"

#include <Eigen/Eigenvalues>
#include <cmath>
#include <gtest/gtest.h>
#include <memory>
#include <random>
#include <vector>

#include "tests/vo_core/bundle_world.h"
#include "tests/vo_core/relative_nees.h"
#include "vo_core/map/pose_certainty.h"
#include "vo_core/map/structure_optimizer.h"
#include "vo_core/tracking/pose_optimizer.h"

namespace godwit::vo {
namespace bundle_adjuster_test {

using World = test::BundleWorld;

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
double nees_of_the_centre(double noise_px, int edgelets_of_ten, double common_px = 0.0) {
  test::RelativeNees nees;
  for (unsigned seed = 1; seed <= 40; ++seed) {
    auto w = std::make_unique<World>(noise_px, edgelets_of_ten, seed, common_px);
    BundleAdjusterOptions options;
    options.max_iterations = 6;
    BundleAdjuster bundle(w->camera, options);
    EXPECT_EQ(bundle.run(&w->map, 5).free_keyframes, 5);
    MapShares shares;
    bundle.shares(w->map, &shares);
    EXPECT_EQ(shares.centre, 6u);
    EXPECT_EQ(shares.count, 6);
    EXPECT_EQ(shares.share[0].keyframe_id, 6u) << "first what the centre's own noise makes of it";
    const SE3& T_n = w->map.keyframe(5).T_kf_world;
    for (int i = 1; i < shares.count; ++i) {
      const MapShare& share = shares.share[static_cast<std::size_t>(i)];
      const int k = static_cast<int>(share.keyframe_id) - 1;
      // Own noise and the map's share make the whole.
      const Mat6 C = shares.share[0].covariance + share.covariance;
      EXPECT_GE(share.covariance.selfadjointView<Eigen::Lower>().eigenvalues().minCoeff(), -1e-9 * C.norm());
      const SE3 told = T_n * w->map.keyframe(k).T_kf_world.inverse();
      const SE3 truth = w->poses[5] * w->poses[static_cast<std::size_t>(k)].inverse();
      nees.add(told, truth, C);
    }
  }
  return nees.mean();
}

TEST(BundleAdjuster, TellsHowCertainTheCentreIs) {
  EXPECT_NEAR(nees_of_the_centre(0.3, 0), 1.0, 0.3);
}

TEST(BundleAdjuster, TellsHowCertainTheCentreIsWithEdgelets) {
  // Where edgelets hold the pose, too, the design effect errs on the careful side (residual_spread.h).
  const double nees = nees_of_the_centre(0.3, 5);
  EXPECT_GT(nees, 0.4);
  EXPECT_LT(nees, 1.3);
}

// Many observations of one point are worth little more than one.
TEST(BundleAdjuster, TellsHowCertainTheCentreIsWhenAPointsErrorsHangTogether) {
  EXPECT_NEAR(nees_of_the_centre(0.1, 0, 0.3), 1.0, 0.3);
}

// The first two keyframes alone: what a wrong motion between them makes of the points agrees with the second one, and
// pulls a frame that has gone on, or to the side.
double nees_of_a_frame_beyond(const Vec3& way, double change_told = 1.0) {
  test::RelativeNees nees;
  for (unsigned seed = 1; seed <= 40; ++seed) {
    auto w = std::make_unique<World>(0.3, 0, seed);
    for (int k = 2; k < 6; ++k) w->map.remove_keyframe(k);
    for (int k = 0; k < 2; ++k) w->map.keyframe(k).median_depth = 2.7;
    BundleAdjusterOptions options;
    options.max_iterations = 10;
    BundleAdjuster bundle(w->camera, options);
    EXPECT_EQ(bundle.run(&w->map, 1).free_keyframes, 1);
    auto shares = std::make_unique<MapShares>();
    bundle.shares(w->map, shares.get());
    PoseCertainty certainty;
    shares->change *= change_told;
    for (MapShare& share : shares->share) share.with_change *= change_told;
    certainty.take(*shares);
    // It sees all points, and measures them with a noise of its own.
    const SE3 truth = SE3{Mat3::Identity(), -way} * w->poses[1];
    std::mt19937 random(seed + 500);
    std::normal_distribution<double> noise(0.0, 0.3);
    std::vector<PoseMeasurement> measured;
    for (std::size_t i = 0; i < w->points.size(); ++i) {
      const MapPoint& p = w->map.point(static_cast<int>(i));
      PoseMeasurement m;
      if (!p.active || !w->camera.project(truth * w->points[i], &m.px)) continue;
      m.px += Vec2(noise(random), noise(random));
      m.p_world = p.p_world;
      measured.push_back(m);
    }
    SE3 T = truth;
    const PoseOptimizerResult fit = optimize_pose(w->camera, {}, measured, &T);
    EXPECT_TRUE(fit.ok);
    const RelativePose told = certainty.relative(w->map, T, 2 * rt::kNsPerSecond, fit.covariance, Mat6::Zero());
    EXPECT_EQ(told.keyframe_id, 2u);
    nees.add(told.T_ref_cam.inverse(), truth * w->poses[1].inverse(), told.covariance);
  }
  return nees.mean();
}

TEST(BundleAdjuster, TellsHowCertainAFrameBeyondTheCentreIs) {
  for (const Vec3& way : {Vec3(0.2, 0.0, 0.0), Vec3(0.0, 0.15, 0.3), Vec3(-0.1, -0.2, 0.1)}) {
    // What a point is off by itself counts twice, in the share and in the frame's residuals: careful.
    const double nees = nees_of_a_frame_beyond(way);
    EXPECT_GT(nees, 0.3) << way.transpose();
    EXPECT_LT(nees, 1.5) << way.transpose();
    EXPECT_GT(nees_of_a_frame_beyond(way, 0.0), 2.0) << "as if the frame were where the keyframe is";
  }
}

}  // namespace bundle_adjuster_test
}  // namespace godwit::vo
