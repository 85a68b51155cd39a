#include "vo_core/geometry/two_view_geometry.h"

#include <gtest/gtest.h>
#include <numeric>

#include "tests/vo_core/scene_points.h"
#include "vo_core/geometry/fundamental.h"
#include "vo_core/geometry/homography.h"

namespace godwit::vo {
namespace two_view_geometry_test {

using namespace scenes;  // NOLINT: the scenes of this folder's tests
constexpr double kFocal = 500.0;

SE3 motion() {
  return {so3_exp(Vec3(0.02, -0.06, 0.03)), Vec3(0.5, -0.1, 0.1)};
}

TEST(Homography, FourPointsGiveTheMapExactly) {
  Mat3 truth;
  truth << 1.1, 0.05, 12, -0.03, 0.95, -7, 1e-4, -2e-4, 1;
  const std::vector<Vec2> a{{-200, -150}, {210, -140}, {190, 160}, {-220, 130}, {17, 23}};
  std::vector<Vec2> b;
  b.reserve(a.size());
  for (const Vec2& p : a) b.push_back((truth * p.homogeneous()).hnormalized());
  Mat3 H;
  const std::vector<int> index{0, 1, 2, 3};
  ASSERT_TRUE(homography_from_points(a, b, index, &H));
  EXPECT_LT(((H * a[4].homogeneous()).hnormalized() - b[4]).norm(), 1e-9);
}

TEST(Homography, PointsOnALineAreRefused) {
  const std::vector<Vec2> a{{0, 0}, {10, 10}, {20, 20}, {30, 30}};
  Mat3 H;
  const std::vector<int> index{0, 1, 2, 3};
  EXPECT_FALSE(homography_from_points(a, a, index, &H));
}

TEST(Homography, DecompositionHoldsTheTruth) {
  const SE3 T = motion();
  const Vec3 normal = Vec3(0.3, 0.2, 1.0).normalized();
  const double distance = 2.0;
  const Mat3 H = T.R + T.t / distance * normal.transpose();
  std::array<PlaneMotion, 4> motions;
  ASSERT_EQ(decompose_homography(2.5 * H, 1e-4, &motions), 4);
  double nearest = 1e9;
  for (const PlaneMotion& m : motions) {
    const Mat3 again = m.T_b_a.R + m.T_b_a.t * m.normal.transpose();
    EXPECT_LT((again - H).norm(), 1e-9) << "each solution must give the homography back";
    EXPECT_NEAR(m.T_b_a.R.determinant(), 1.0, 1e-9);
    nearest =
        std::min(nearest, (m.T_b_a.t - T.t / distance).norm() + (m.T_b_a.R - T.R).norm() + (m.normal - normal).norm());
  }
  EXPECT_LT(nearest, 1e-9);
}

TEST(Homography, APlaneHasOneOtherMotion) {
  const Vec3 plane = Vec3(0.3, 0.2, 1.0) / 2.0;
  const SE3 T = motion();
  SE3 other;
  ASSERT_TRUE(other_motion_of_plane(T, plane, &other));
  EXPECT_GT((other.R - T.R).norm(), 0.01);
  // It sees the plane's points on the same rays' planes: the epipolar constraint holds for each.
  for (const Vec2& p : {Vec2(0.0, 0.0), Vec2(-0.4, 0.3), Vec2(0.5, 0.2), Vec2(0.1, -0.4)}) {
    const Vec3 ray = p.homogeneous(), seen = T * (ray / plane.dot(ray));
    EXPECT_NEAR(seen.normalized().dot(other.t.normalized().cross(other.R * ray)), 0.0, 1e-9);
  }
  // Along the normal the two are one: nothing tells a tilt of the plane from a turn and a sidestep.
  const SE3 along(T.R, T.R * plane.normalized() * 0.3);
  ASSERT_TRUE(other_motion_of_plane(along, plane, &other));
  EXPECT_LT((other.R - along.R).norm() + (other.t - along.t).norm(), 1e-6);
}

TEST(Homography, RotationHasNoPlane) {
  std::array<PlaneMotion, 4> motions;
  EXPECT_EQ(decompose_homography(motion().R, 1e-4, &motions), 0);
}

TEST(Fundamental, EightPointsGiveTheEpipolarLinesAndTheMotion) {
  std::mt19937 random(1);
  const SE3 T = motion();
  const auto points = make_points(Scene::kGeneral, 20, &random);
  const auto a = observe(points, {}, 0, &random), b = observe(points, T, 0, &random);
  std::vector<int> index(8);
  std::iota(index.begin(), index.end(), 0);
  Mat3 F;
  ASSERT_TRUE(fundamental_from_points(a, b, index, &F));
  EXPECT_NEAR(F.determinant(), 0.0, 1e-12);
  for (std::size_t i = 0; i < a.size(); ++i) {
    EXPECT_NEAR(b[i].homogeneous().dot(F * a[i].homogeneous()), 0.0, 1e-9);
  }
  double nearest = 1e9;
  for (const SE3& m : decompose_essential(F))
    nearest = std::min(nearest, (m.R - T.R).norm() + (m.t - T.t.normalized()).norm());
  EXPECT_LT(nearest, 1e-6);
}

TEST(TwoView, TriangulationIsExactWithoutNoise) {
  const SE3 T = motion();
  const Vec3 p(0.4, -0.2, 2.5), q = T * p;
  double inverse_depth = 0;
  ASSERT_TRUE(triangulate_inverse_depth(T, p.hnormalized(), q.hnormalized(), &inverse_depth));
  EXPECT_NEAR(inverse_depth, 1 / 2.5, 1e-12);
  EXPECT_FALSE(triangulate_inverse_depth({T.R, Vec3::Zero()}, p.hnormalized(), q.hnormalized(), &inverse_depth));
}

struct Case {
  Scene scene;
  InitModel expected;
};

class TwoViewModel : public ::testing::TestWithParam<Case> {};

// The paper, section 2.4: a plane gives R_H above 0.4, a general scene below; both under noise and 30 % outliers.
TEST_P(TwoViewModel, IsPickedAndHoldsTheMotion) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    std::mt19937 random(seed);
    const auto points = make_points(GetParam().scene, 300, &random);
    const SE3 T = motion();
    const auto a = observe(points, {}, 0, &random);
    auto b = observe(points, T, 0.5 / kFocal, &random);
    spoil(0.3, &b, &random);
    TwoViewGeometry geometry({});
    const auto r = geometry.estimate(scaled(a, kFocal), scaled(b, kFocal), kFocal);
    ASSERT_EQ(r.model, GetParam().expected) << "seed " << seed << " R_H " << r.ratio_homography;
    EXPECT_GT(r.inliers, 150);
    EXPECT_LT(r.inliers, 230);
    double nearest = 1e9;
    for (int i = 0; i < r.candidate_count; ++i) {
      const auto& c = r.candidates[static_cast<std::size_t>(i)];
      if (c.model == r.model)
        nearest = std::min(nearest, direction_error_deg(c.T_b_a, T) + rotation_error_deg(c.T_b_a, T));
    }
    EXPECT_LT(nearest, 3.0) << "seed " << seed;
  }
}

INSTANTIATE_TEST_SUITE_P(Scenes, TwoViewModel,
                         ::testing::Values(Case{Scene::kPlane, InitModel::kHomography},
                                           Case{Scene::kGeneral, InitModel::kFundamental}));

TEST(TwoView, SameInputSameResultToTheBit) {
  std::mt19937 random(3);
  const auto points = make_points(Scene::kGeneral, 200, &random);
  const auto a = scaled(observe(points, {}, 0, &random), kFocal);
  const auto b = scaled(observe(points, motion(), 1e-3, &random), kFocal);
  TwoViewGeometry one({}), two({});
  (void)one.estimate(b, a, kFocal);  // an earlier call must leave no trace
  const auto r = one.estimate(a, b, kFocal), s = two.estimate(a, b, kFocal);
  ASSERT_EQ(r.candidate_count, s.candidate_count);
  EXPECT_EQ(r.score_homography, s.score_homography);
  EXPECT_EQ(r.score_fundamental, s.score_fundamental);
  for (std::size_t i = 0; i < static_cast<std::size_t>(r.candidate_count); ++i) {
    EXPECT_EQ(r.candidates[i].T_b_a.R, s.candidates[i].T_b_a.R);
    EXPECT_EQ(r.candidates[i].T_b_a.t, s.candidates[i].T_b_a.t);
  }
}

TEST(TwoView, TooFewOrCoincidingPointsGiveNoModel) {
  TwoViewGeometry geometry({});
  const std::vector<Vec2> seven(7, Vec2(1, 2)), many(50, Vec2(1, 2));
  EXPECT_EQ(geometry.estimate(seven, seven, kFocal).model, InitModel::kNone);
  EXPECT_EQ(geometry.estimate(many, many, kFocal).model, InitModel::kNone);
}

}  // namespace two_view_geometry_test
}  // namespace godwit::vo
