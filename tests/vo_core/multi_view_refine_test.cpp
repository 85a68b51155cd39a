#include "vo_core/map/multi_view_refine.h"

#include <algorithm>
#include <array>
#include <gtest/gtest.h>

#include "tests/vo_core/numeric_jacobian.h"
#include "tests/vo_core/scene_points.h"
#include "vo_core/geometry/rotation_fit.h"
#include "vo_core/map/inverse_depth_rows.h"

namespace godwit::vo {
namespace multi_view_refine_test {

using namespace scenes;  // NOLINT: the scenes of this folder's tests
constexpr double kFocal = 500.0;

TEST(InverseDepthTerms, JacobiansAgreeWithNumericOnes) {
  const SE3 T(so3_exp(Vec3(0.1, -0.2, 0.05)), Vec3(0.3, -0.2, 0.1));
  const Vec3 ray(0.3, -0.25, 1.0);
  const double rho = 0.4;
  const auto prediction = [&](const SE3& pose, double inverse_depth) {
    return Vec2(kFocal * (pose.R * ray + inverse_depth * pose.t).hnormalized());
  };
  const Vec3 q0 = T.R * ray, q = q0 + rho * T.t;
  InverseDepthTerms<double> e;
  e.set({q0.x(), q0.y(), q0.z()}, {T.t.x(), T.t.y(), T.t.z()}, rho, q.x() / q.z(), q.y() / q.z(), kFocal / q.z());
  Mat23 J_t, J_w;
  J_t << e.J0[0], e.J0[1], e.J0[2], e.J1[0], e.J1[1], e.J1[2];
  J_w << e.J0[3], e.J0[4], e.J0[5], e.J1[3], e.J1[4], e.J1[5];
  EXPECT_TRUE(test::agrees(J_t, test::numeric_jacobian<3>([&](const Vec3& d) {
                             return prediction({T.R, T.t + d}, rho);
                           })));
  EXPECT_TRUE(test::agrees(J_w, test::numeric_jacobian<3>([&](const Vec3& d) {
                             return prediction({so3_exp(d) * T.R, T.t}, rho);
                           })));
  using One = Eigen::Matrix<double, 1, 1>;
  EXPECT_TRUE(test::agrees(Vec2(e.rho0, e.rho1),
                           test::numeric_jacobian<1>([&](const One& d) { return prediction(T, rho + d.value()); })));
}

TEST(RotationFit, DerivativesAreThoseOfDifferences) {
  const Mat3 R = so3_exp(Vec3(0.1, -0.2, 0.3));
  for (const Vec2& a : {Vec2(0.3, -0.2), Vec2(-0.5, 0.4), Vec2(0.0, 0.0)}) {
    const Vec2 b(0.1, -0.3);
    Vec2 r;
    Mat23 J;
    ASSERT_TRUE(rotation_residual(R, a, b, kFocal, &r, &J));
    EXPECT_TRUE(test::agrees(J, test::numeric_jacobian<3>([&](const Vec3& w) {
                               Vec2 there = Vec2::Zero();
                               Mat23 unused;
                               EXPECT_TRUE(rotation_residual(so3_exp(w) * R, a, b, kFocal, &there, &unused));
                               return there;
                             })));
  }
  Vec2 r;
  Mat23 J;
  EXPECT_FALSE(rotation_residual(so3_exp(Vec3(0, 3.1, 0)), Vec2(0, 0), Vec2(0, 0), kFocal, &r, &J)) << "behind";
}

TEST(InverseDepthRows, PointsBehindTheViewAreCountedAndLeftOut) {
  const std::array<double, 4> zero{}, rho{0.5, 0.1, 0.0, 0.0};
  Mat6 A;
  Vec6 b;
  const InverseDepthRows rows{zero.data(), zero.data(), rho.data(), zero.data(), zero.data(), 2, kFocal};
  EXPECT_EQ(build_rows({Mat3::Identity(), Vec3(0, 0, -3)}, rows, 1.0, &A, &b, nullptr), 1);
  const InverseDepthRows behind{zero.data(), zero.data(), rho.data(), zero.data(), zero.data(), 1, kFocal};
  EXPECT_EQ(build_rows({Mat3::Identity(), Vec3(0, 0, -3)}, behind, 1.0, &A, &b, nullptr), 1);
  EXPECT_EQ(A.norm(), 0.0);
}

struct Problem {
  static constexpr int kViews = 8;
  std::vector<Vec3> points;
  std::vector<SE3> T;  // truth, last distance 1
  MultiViewState state;

  /// Sideways motion of a twentieth of the depth in eight steps; outliers in the last view only.
  Problem(MultiViewRefiner* refiner, double noise_px, double outliers, unsigned seed) {
    std::mt19937 random(seed);
    points = make_points(Scene::kGeneral, 200, &random);
    const SE3 end(so3_exp(Vec3(0.02, -0.03, 0.01)), Vec3(0.15, 0.02, 0.01));
    refiner->begin(observe(points, {}, 0, &random), kFocal, 0.05);
    for (int k = 1; k <= kViews; ++k) {
      const double f = static_cast<double>(k) / kViews;
      const SE3 truth(so3_exp(f * so3_log(end.R)), f * end.t);
      auto xy = observe(points, truth, noise_px / kFocal, &random);
      if (k == kViews) spoil(outliers, &xy, &random);
      refiner->add_view(xy);
      T.push_back({truth.R, truth.t / end.t.norm()});
      // Wrong by a good deal: the rotation by 0.3 degrees, the direction by 10.
      state.T_view_ref[static_cast<std::size_t>(k - 1)] = {so3_exp(Vec3(0.003, -0.003, 0.003)) * truth.R,
                                                           so3_exp(Vec3(0.1, 0.1, 0.1)) * T.back().t};
    }
    for (std::size_t i = 0; i < points.size(); ++i) {
      points[i] /= end.t.norm();
      state.inverse_depth[i] = 1.0 / (3.0 / end.t.norm());  // all at one depth
    }
  }
};

TEST(MultiViewRefine, FindsTheTruthWithoutNoise) {
  MultiViewRefiner refiner;
  Problem p(&refiner, 0.0, 0.0, 5);
  for (int i = 0; i < 4; ++i) refiner.refine(10, &p.state);
  EXPECT_LT(direction_error_deg(p.state.T_view_ref[7], p.T[7]), 1e-3);
  for (std::size_t k = 0; k < 8; ++k) {
    EXPECT_LT(rotation_error_deg(p.state.T_view_ref[k], p.T[k]), 1e-4);
    EXPECT_LT((p.state.T_view_ref[k].t - p.T[k].t).norm(), 1e-4);
  }
  for (std::size_t i = 0; i < p.points.size(); ++i) EXPECT_NEAR(p.state.inverse_depth[i] * p.points[i].z(), 1.0, 1e-4);
}

TEST(MultiViewRefine, StandsOutliersInOneView) {
  MultiViewRefiner refiner;
  Problem p(&refiner, 0.2, 0.3, 6);
  for (int i = 0; i < 4; ++i) refiner.refine(10, &p.state);
  EXPECT_LT(direction_error_deg(p.state.T_view_ref[7], p.T[7]), 2.0);
  EXPECT_LT(rotation_error_deg(p.state.T_view_ref[7], p.T[7]), 0.1);
}

// The reported uncertainty must be what the errors show: over many trials (error / sigma)^2 is 1 on average, the common
// scale taken out.
TEST(MultiViewRefine, DepthSigmaIsHonest) {
  double sum = 0, sum_of_baselines = 0;
  int count = 0;
  for (unsigned seed = 1; seed <= 20; ++seed) {
    MultiViewRefiner refiner;
    Problem p(&refiner, 0.3, 0.0, seed);
    for (int i = 0; i < 4; ++i) refiner.refine(10, &p.state);
    const double noise = refiner.sigma(p.state);
    EXPECT_NEAR(noise, 0.3, 0.05);
    const std::vector<std::uint8_t> use(p.points.size(), 1);
    std::vector<double> sigma(p.points.size());
    double baseline = 0;
    ASSERT_TRUE(refiner.relative_depth_sigma(p.state, noise, use, sigma, &baseline));
    double mean = 0;
    std::vector<double> error;
    for (std::size_t i = 0; i < p.points.size(); ++i) {
      error.push_back(std::log(p.state.inverse_depth[i] * p.points[i].z()));
      mean += error.back() / static_cast<double>(p.points.size());
    }
    sum_of_baselines += mean * mean / (baseline * baseline);
    for (std::size_t i = 0; i < error.size(); ++i) {
      sum += (error[i] - mean) * (error[i] - mean) / (sigma[i] * sigma[i]);
      ++count;
    }
  }
  EXPECT_GT(sum / count, 0.7);
  EXPECT_LT(sum / count, 1.4);
  // Of 20 values: chi-square's 99.8 of 100.
  EXPECT_GT(sum_of_baselines, 5.9);
  EXPECT_LT(sum_of_baselines, 45.3);
}

TEST(FitRotation, LeavesNothingOverUnderPureRotationAndParallaxOtherwise) {
  std::mt19937 random(8);
  const auto points = make_points(Scene::kGeneral, 200, &random);
  const SE3 turn(so3_exp(Vec3(0.1, -0.15, 0.2)), Vec3::Zero()), move(turn.R, Vec3(0.2, 0, 0));
  const auto a = observe(points, {}, 0, &random);
  std::vector<double> scratch(a.size());
  Mat3 R = Mat3::Identity();
  EXPECT_LT(fit_rotation(a, observe(points, turn, 0, &random), kFocal, scratch, &R), 1e-6);
  EXPECT_LT((R - turn.R).norm(), 1e-9);
  EXPECT_GT(fit_rotation(a, observe(points, move, 0, &random), kFocal, scratch, &R), 3.0);
}

}  // namespace multi_view_refine_test
}  // namespace godwit::vo
