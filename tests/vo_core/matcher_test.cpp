#include "vo_core/map/matcher.h"

#include <cmath>
#include <gtest/gtest.h>
#include <vector>

#include "tests/vo_core/synthetic_scene.h"
#include "vo_core/image/pyramid.h"

namespace godwit::vo {
namespace matcher_test {

struct Views {
  CameraModel camera = CameraModel::pinhole_radtan(320, 240, 260, 260, 160, 120, {0.05, -0.02, 0, 0, 0}).value();
  test::SyntheticScene scene = test::SyntheticScene::plane();
  SE3 T_ref, T_cur = SE3::exp((Vec6() << -0.25, 0.05, -0.1, 0.01, 0.02, 0.1).finished());
  test::Picture a = scene.render(camera, T_ref), b = scene.render(camera, T_cur);
  std::vector<std::uint8_t> storage_a, storage_b;
  rt::PyramidView ref, cur;

  Views() { build_both(); }
  void build_both() {
    const auto build = [](const test::Picture& p, std::vector<std::uint8_t>* s) {
      s->resize(pyramid_bytes(320, 240, 4) + 256);
      return build_pyramid(p.view(), 4, test::aligned(s), s->size() - rt::kRowAlignment);
    };
    ref = build(a, &storage_a);
    cur = build(b, &storage_b);
  }
  KeyframeFeature feature(double x, double y) const {
    KeyframeFeature f;
    f.px = f.px_global = Vec2f(static_cast<float>(x), static_cast<float>(y));
    f.bearing = camera.unproject(Vec2(x, y));
    return f;
  }
  /// Features on a grid, with their distance, that `cur` shows at `seen`, at least `border` pixels inside.
  struct Visible {
    KeyframeFeature feature;
    double distance;
    Vec2 seen;
  };
  std::vector<Visible> visible(int spacing, double border) const {
    std::vector<Visible> out;
    for (int y = 60; y < 190; y += spacing) {
      for (int x = 60; x < 260; x += spacing) {
        const KeyframeFeature f = feature(x, y);
        const double d = distance(f);
        Vec2 seen;
        if (camera.project(T_cur * (f.bearing * d), &seen) && camera.in_image(seen, border))
          out.push_back({f, d, seen});
      }
    }
    return out;
  }
  double distance(const KeyframeFeature& f) const {
    return scene.depth(camera, T_ref, f.px.cast<double>()) / f.bearing.z();
  }
};

TEST(Matcher, WarpMatrixIsTheDerivativeOfTheWarp) {
  const Views v;
  const KeyframeFeature f = v.feature(150, 110);
  const double d = v.distance(f);
  Eigen::Matrix2f A;
  ASSERT_TRUE(warp_matrix(v.camera, {&v.ref, &f, d}, v.T_cur, &A));
  // Neighbouring rays cut with the plane that faces the reference camera at the point.
  const auto there = [&](const Vec2& px) {
    const Vec3 g = v.camera.unproject(px);
    Vec2 out;
    EXPECT_TRUE(v.camera.project(v.T_cur * (g * (d / g.dot(f.bearing))), &out));
    return out;
  };
  const Vec2 px = f.px.cast<double>();
  Eigen::Matrix2d N;
  N.col(0) = (there(px + Vec2(0.5, 0)) - there(px - Vec2(0.5, 0)));
  N.col(1) = (there(px + Vec2(0, 0.5)) - there(px - Vec2(0, 0.5)));
  EXPECT_LT((A.cast<double>() - N).norm(), 5e-3);
}

TEST(Matcher, AnEdgesNormalStaysNormalToItInTheOtherView) {
  const Views v;
  KeyframeFeature f = v.feature(150, 110);
  f.type = FeatureType::kEdgelet;
  const double d = v.distance(f);
  // Rolled, and so much from the side that A shears.
  const SE3 T = SE3::exp((Vec6() << -1.6, 0.1, 0.3, 0.0, 0.5, 0.3).finished());
  Vec2 seen;
  ASSERT_TRUE(v.camera.project(T * (f.bearing * d), &seen));
  Eigen::Matrix2f A;
  ASSERT_TRUE(warp_matrix(v.camera, {&v.ref, &f, d}, T, &A));
  for (double angle = 0.0; angle < 3.0; angle += 0.3) {
    f.gradient = Vec2f(static_cast<float>(std::cos(angle)), static_cast<float>(std::sin(angle)));
    const MatchResult m = match_direct(v.camera, {&v.ref, &f, d}, T, v.cur, seen.cast<float>(), 3);
    const Vec2f along = (A * Vec2f(-f.gradient.y(), f.gradient.x())).normalized();
    EXPECT_NEAR(m.gradient.dot(along), 0.0f, 1e-3f) << angle;
    // And from dark to bright as before.
    EXPECT_GT(m.gradient.dot(A * f.gradient), 0.0f) << angle;
  }
}

TEST(Matcher, SearchLevelFollowsTheScale) {
  EXPECT_EQ(search_level(Eigen::Matrix2f::Identity(), 0, 3), 0);
  EXPECT_EQ(search_level(Eigen::Matrix2f::Identity(), 2, 3), 2);
  EXPECT_EQ(search_level(2.2f * Eigen::Matrix2f::Identity(), 0, 3), 1);
  EXPECT_EQ(search_level(20.0f * Eigen::Matrix2f::Identity(), 0, 3), 3) << "never above the top level";
}

TEST(Matcher, DirectMatchFindsThePointAndEpipolarSearchItsDepth) {
  const Views v;
  int direct = 0, epipolar = 0, displaced = 0, not_displaced = 0;
  const auto visible = v.visible(25, 15);
  const int tried = static_cast<int>(visible.size());
  for (const auto& [f, d, truth] : visible) {
    const MatchResult m =
        match_direct(v.camera, {&v.ref, &f, d}, v.T_cur, v.cur, (truth + Vec2(1.0, -0.8)).cast<float>(), 3);
    direct += m.found && (m.px.cast<double>() - truth).norm() < 0.25;
    const EpipolarResult e = match_epipolar(v.camera, {&v.ref, &f, 2.0}, v.T_cur, v.cur, 1.2, 8.0, 3);
    EXPECT_TRUE(e.visible);
    if (e.match.found) epipolar += std::abs(e.depth - d) < 0.03 * d;
    // What a rolling shutter has moved is searched for where it lies, and tells the depth of where it would be.
    const SE3 turned = SE3{so3_exp(Vec3(0.02, 0.015, 0.0)), Vec3::Zero()} * v.T_cur;
    Vec2 there;
    if (!e.match.found || !v.camera.project(turned * (f.bearing * d), &there)) continue;
    const EpipolarResult moved = match_epipolar(v.camera, {&v.ref, &f, 2.0}, turned, v.cur, 1.2, 8.0, 3, truth - there);
    const EpipolarResult as_it_lies = match_epipolar(v.camera, {&v.ref, &f, 2.0}, turned, v.cur, 1.2, 8.0, 3);
    displaced += moved.match.found && std::abs(moved.depth - d) < 0.06 * d;
    not_displaced += as_it_lies.match.found && std::abs(as_it_lies.depth - d) < 0.06 * d;
  }
  EXPECT_GE(displaced, epipolar * 8 / 10);
  EXPECT_LE(not_displaced, displaced / 2);
  ASSERT_GT(tried, 20);
  EXPECT_GE(direct, tried * 8 / 10);
  EXPECT_GE(epipolar, tried * 6 / 10);
}

TEST(Matcher, ACoarserLevelFindsWhatMotionBlurTookFromTheFineOne) {
  Views v;
  // The picture as the camera sees it that turns by 9 pixels while the shutter is open.
  const test::Picture sharp = v.b;
  constexpr int kHalf = 4;
  for (int y = 0; y < 240; ++y) {
    for (int x = kHalf; x < 320 - kHalf; ++x) {
      int sum = 0;
      for (int d = -kHalf; d <= kHalf; ++d) sum += sharp.view().at(x + d, y);
      v.b(x, y) = static_cast<std::uint8_t>(sum / (2 * kHalf + 1));
    }
  }
  v.build_both();
  int fine = 0, coarse = 0;
  const auto visible = v.visible(13, 25);
  const int tried = static_cast<int>(visible.size());
  for (const auto& one : visible) {
    const auto near = [&](int coarser) {
      const MatchResult m = match_direct(v.camera, {&v.ref, &one.feature, one.distance}, v.T_cur, v.cur,
                                         (one.seen + Vec2(1.0, -0.8)).cast<float>(), 3, coarser);
      EXPECT_TRUE(!m.found || m.level == coarser);
      return m.found && (m.px.cast<double>() - one.seen).norm() < 1.0;
    };
    const bool on_the_fine = near(0);
    fine += on_the_fine;
    coarse += on_the_fine || near(1);
  }
  ASSERT_GT(tried, 60);
  EXPECT_GT(coarse, fine * 5 / 4) << fine << " and " << coarse << " of " << tried;
  const KeyframeFeature f = v.feature(150, 110);
  EXPECT_FALSE(match_direct(v.camera, {&v.ref, &f, v.distance(f)}, SE3(), v.cur, f.px, 3, 4).found) << "above the top";
}

TEST(Matcher, APlaceThatIsNotFiniteHasNoPatch) {
  const Views v;
  KeyframeFeature f = v.feature(150, 110);
  const double distance = v.distance(f);
  for (const float wrong : {std::nanf(""), HUGE_VALF, -HUGE_VALF, 3e38f}) {
    for (const Vec2f& px : {Vec2f(wrong, 110), Vec2f(150, wrong), Vec2f(wrong, wrong)}) {
      f.px = px;
      ReferencePatch patch;
      EXPECT_FALSE(warp_patch({&v.ref, &f, distance}, Eigen::Matrix2f::Identity(), 0, &patch)) << px.transpose();
      EXPECT_FALSE(match_direct(v.camera, {&v.ref, &f, distance}, v.T_cur, v.cur, Vec2f(150, 110), 3).found);
    }
  }
}

TEST(Matcher, TriangulationRefusesParallelRays) {
  double depth = 0;
  SE3 T;
  T.t = Vec3(0.1, 0, 0);
  EXPECT_FALSE(depth_from_triangulation(T, Vec3::UnitZ(), Vec3::UnitZ(), &depth));
  const Vec3 p(0.2, 0.1, 2.0);
  ASSERT_TRUE(depth_from_triangulation(T, p.normalized(), (T * p).normalized(), &depth));
  EXPECT_NEAR(depth, p.norm(), 1e-9);
}

}  // namespace matcher_test
}  // namespace godwit::vo
