// A rolling shutter on an aircraft that shakes: what each picture alone is off by is no walk, and an attitude is that
// of all its rows.
#include <Eigen/Cholesky>
#include <cmath>
#include <gtest/gtest.h>
#include <numbers>

#include "tests/vo_core/inertial_flown.h"
#include "tests/vo_core/numeric_jacobian.h"
#include "vo_core/inertial/rolling_sight.h"

namespace godwit::vo {
namespace inertial_rolling_test {

using S = InertialState;
using test::Flight;
using test::Flown;

constexpr double kReadoutS = 15e-3;

/// What a camera that looks down on a flat ground one unit away errs by in one picture, left twist (v, w): a turn is
/// taken for a way, as both move the picture alike. 6 mrad, and a tenth of it beside that.
Mat6 shaking() {
  constexpr double kTurn = 6e-3, kBeside = 6e-4;
  Eigen::Matrix<double, 6, 3> by_turn = Eigen::Matrix<double, 6, 3>::Zero();
  by_turn.bottomRows<3>() = kTurn * Mat3::Identity();
  by_turn(0, 1) = -kTurn;
  by_turn(1, 0) = kTurn;
  return by_turn * by_turn.transpose() + kBeside * kBeside * Mat6::Identity();
}

/// The flight seen through it: each picture errs anew, and the tracker says so, of the picture and of the keyframe.
VisualPose shaken(Flight* f, int k) {
  const InertialNode seen = f->node(k, {});
  VisualPose pose;
  pose.t_ns = seen.t_ns;
  pose.tracked = true;
  pose.map_id = 1;
  Vec6 standard;
  standard << f->random(), f->random();
  const Mat6 L = shaking().llt().matrixL();
  const SE3 T_cam_map = SE3(seen.sight.R_map_cam, seen.sight.camera).inverse();
  pose.T_map_cam = (SE3::exp(L * standard) * T_cam_map).inverse();
  pose.own_covariance = shaking();
  pose.covariance = 3 * shaking();
  pose.relative_covariance = 2 * shaking() + 1e-8 * Mat6::Identity();
  pose.relative_age_ns = rt::kNsPerSecond / 2;
  return pose;
}

/// What an odometry made of 6 s of it.
struct Found {
  double begun_s = -1, scale_sigma = 0, scale_off = 0;
};

Found fly(unsigned seed, double readout_s) {
  Flight f(1.0, seed);
  InertialOdometryOptions options;
  options.model = f.model_;
  options.readout_ns = std::llround(readout_s * 1e9);
  InertialOdometry odometry(f.mounting_, options);
  Found out;
  for (int k = 0; k < 120; ++k) {
    for (int i = 1; i <= 10; ++i) {
      ImuReading r = f.reading(k / 20.0 - 0.05 + i / 200.0);
      r.gyro_rad_s += f.model_.imu.gyro * std::sqrt(200.0) * f.random();
      r.accel_m_s2 += f.model_.imu.accel * std::sqrt(200.0) * f.random();
      odometry.add(r);
    }
    const MetricPose pose = odometry.frame(shaken(&f, k));
    if (pose.valid && out.begun_s < 0) out.begun_s = k / 20.0;
  }
  out.scale_sigma = std::sqrt(odometry.smoother().covariance()(S::kScale, S::kScale));
  out.scale_off = odometry.smoother().newest().log_scale - std::log(f.scale_);
  return out;
}

TEST(InertialRolling, WhatOnePictureIsOffByIsNoWalkAndHidesNoScale) {
  double off2 = 0;
  constexpr int kFlights = 12;
  for (unsigned seed = 1; seed <= kFlights; ++seed) {
    const Found found = fly(500 + seed, kReadoutS);
    EXPECT_GT(found.begun_s, 0) << seed << ": it begins";
    EXPECT_LT(found.begun_s, 4) << seed;
    EXPECT_LT(found.scale_sigma, 0.05) << seed;
    EXPECT_LT(std::abs(found.scale_off), 3.5 * found.scale_sigma) << seed;
    off2 += found.scale_off * found.scale_off / (found.scale_sigma * found.scale_sigma) / kFlights;
  }
  EXPECT_LT(off2, 2.5) << "and is as sure of the scale as it may be";
  EXPECT_GT(off2, 0.1);
}

TEST(InertialRolling, JacobiansAreThoseOfDifferences) {
  const CameraMounting m = test::slanted_mounting();
  InertialState i, j;
  i.R_map_body = so3_exp(Vec3(0.3, -0.2, 0.5));
  i.camera = Vec3(0.2, 0.1, -0.3);
  i.velocity = Vec3(0.5, -1, 0.3);
  i.picture << 4e-3, -3e-3, 1e-3, 2e-3, 5e-3, -1e-3;
  j = i;
  j.R_map_body = so3_exp(Vec3(0.35, -0.1, 0.45));
  j.camera += Vec3(0.05, -0.1, 0.02);
  j.picture << -2e-3, 1e-3, 3e-3, -4e-3, 1e-3, 2e-3;
  const auto sight_of = [&](const InertialState& x) {
    VisionSight s;
    s.R_map_cam = x.R_map_body * m.R_body_cam * so3_exp(Vec3(4e-3, 2e-3, -1e-3));
    s.camera = x.camera + Vec3(1e-3, -2e-3, 3e-3);
    s.own_information = 1e4 * Mat6::Identity();
    return s;
  };
  const VisionSight at_i = sight_of(i), at_j = sight_of(j);
  Preintegration d;
  for (int k = 0; k < 20; ++k) d.add(Vec3(0.5, -0.4, 0.3), Vec3(1, 2, 9.0), 0.005, {});
  PairJacobian J_i, J_j;
  pair_residual(i, j, d, at_i, at_j, m, InertialModel{}, &J_i, &J_j);
  using E = S::Error;
  const auto by_i = test::numeric_jacobian<S::kSize>(
      [&](const E& e) { return pair_residual(i.plus(e), j, d, at_i, at_j, m, InertialModel{}, nullptr, nullptr); });
  const auto by_j = test::numeric_jacobian<S::kSize>(
      [&](const E& e) { return pair_residual(i, j.plus(e), d, at_i, at_j, m, InertialModel{}, nullptr, nullptr); });
  EXPECT_LT((by_i - J_i).rightCols<6>().cwiseAbs().maxCoeff(), 2e-6) << by_i - J_i;
  EXPECT_LT((by_j - J_j).rightCols<6>().cwiseAbs().maxCoeff(), 2e-6) << by_j - J_j;
  EXPECT_GT(J_i.rightCols<6>().norm(), 1);
}

TEST(InertialRolling, AnAttitudeIsTheMeanOfItsRows) {
  // 85 Hz of 1 mrad about the body's y, on a steady turn and a bias.
  constexpr double kAmplitude = 1e-3, kRate = 2 * std::numbers::pi * 85;
  ImuBuffer buffer;
  for (int k = 0; k <= 400; ++k) {
    const double t = k * 1e-3;
    ImuReading r;
    r.t_ns = std::llround(t * 1e9);
    r.gyro_rad_s = Vec3(0.3, -0.1 + kAmplitude * kRate * std::cos(kRate * t), 0.2);
    ASSERT_TRUE(buffer.add(r));
  }
  for (const double t : {0.1, 0.1035, 0.2071, 0.31}) {
    const Vec3 mean = buffer.mean_turn(std::llround(t * 1e9), std::llround(kReadoutS * 1e9));
    const double half = 0.5 * kReadoutS;
    const double expected =
        kAmplitude *
        ((std::cos(kRate * (t - half)) - std::cos(kRate * (t + half))) / (kRate * kReadoutS) - std::sin(kRate * t));
    EXPECT_NEAR(mean.y(), expected, 0.04 * kAmplitude) << t << ": one reading a millisecond";
    EXPECT_LT(std::hypot(mean.x(), mean.z()), 1e-9) << "a steady turn has none";
  }
  VisualPose pose;
  VisionSight sight;
  see_rolling(pose, Mat3::Identity(), Vec3(0, 2e-3, 0), {}, &sight);
  EXPECT_LT((sight.R_map_cam * so3_exp(Vec3(0, 2e-3, 0)) - Mat3::Identity()).norm(), 1e-9);
  EXPECT_FALSE(sight.shakes()) << "where the tracker says nothing of its own noise";
}

TEST(InertialRolling, TurnsAndPlacesErrTogetherAsTheTrackerSays) {
  VisualPose pose;
  pose.T_map_cam.R = so3_exp(Vec3(0.4, -0.7, 0.2));
  pose.own_covariance = shaking();
  pose.relative_covariance = 2 * shaking();
  VisionSight sight;
  see_rolling(pose, Mat3::Identity(), Vec3::Zero(), {}, &sight);
  ASSERT_TRUE(sight.shakes());
  // What a small twist does to attitude and place, along the map's axes.
  Vec6 x;
  x << 2e-6, -1e-6, 3e-6, -4e-6, 1e-6, 2e-6;
  const SE3 wrong = (SE3::exp(x) * pose.T_map_cam.inverse()).inverse();
  Vec6 seen;
  seen << so3_log(wrong.R * pose.T_map_cam.R.transpose()), wrong.t - pose.T_map_cam.t;
  const double asked = x.dot(shaking().llt().solve(x)), told = seen.dot(sight.own_information * seen);
  EXPECT_NEAR(told / asked, 1, 0.05);
  EXPECT_LT((sight.walk_correlation - sight.walk_correlation.transpose()).norm(), 1e-12);
  EXPECT_NEAR(sight.walk_correlation.diagonal().minCoeff(), 1, 1e-12);
}

}  // namespace inertial_rolling_test
}  // namespace godwit::vo
