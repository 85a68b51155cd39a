// A flight for tests of what is metric without an inertial sensor: known exactly, seen in a slanted map of another
// scale over flat ground, with an autopilot's attitude and sensors of lengths beside it.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <random>
#include <vector>

#include "vo_core/inertial/aided_odometry.h"

namespace godwit::vo::test {

/// Whether a pose that is told is off by no more than it says: heading and place of the first one are given.
struct Nees {
  double place = 0, attitude = 0;
};

/// 20 pictures and 10 attitudes a second. Axes of the world: z up; of the body: front, right, down.
class AidedFlown {
 public:
  explicit AidedFlown(unsigned seed, double own = 1) : engine_(seed) {
    const Vec3 axis = Vec3::UnitZ().cross(kUp);
    R_map_world_ = so3_exp(axis.normalized() * std::atan2(axis.norm(), kUp.z())) * so3_exp(Vec3(0, 0, 0.7));
    mounting_.R_body_cam = so3_exp(Vec3(0, -0.7, 0)) * camera_axes();
    mounting_.t_body_cam_m = Vec3(0.08, 0, 0.04);
    for (double& angle : lean_) angle = kLean * noise();
    range_bias_ = std::exp(0.05 * own * noise());
    odometry_ = std::make_unique<AidedOdometry>(mounting_);
  }

  double noise() { return normal_(engine_); }
  Vec3 noise3() { return {noise(), noise(), noise()}; }
  /// Camera axes (right, down, ahead) along the body's.
  static Mat3 camera_axes() {
    Mat3 R;
    R << 0, 0, 1, 1, 0, 0, 0, 1, 0;
    return R;
  }
  /// Wanders, climbs and descends; straight and level where level_ says so.
  Vec3 p(double t) const {
    const double climbed = std::min(t, level_after_);
    return {3 * t, 6 * std::sin(0.2 * climbed), 14 + 5 * std::sin(0.25 * climbed)};
  }
  Mat3 R(double t) const {
    return so3_exp(Vec3(0, 0, 0.3 * std::sin(0.15 * t))) *
           so3_exp(Vec3(0.08 * std::sin(0.5 * t), 0.06 * std::sin(0.4 * t + 1), 0)) *
           Vec3(1, -1, -1).asDiagonal().toDenseMatrix();
  }
  SE3 camera(double t) const { return {R(t) * mounting_.R_body_cam, p(t) + R(t) * mounting_.t_body_cam_m}; }
  Vec3 in_map(const Vec3& place) const { return R_map_world_ * place / scale_ + Vec3(1, -2, 0.5); }

  static rt::TimeNs ns(double t) { return static_cast<rt::TimeNs>(std::llround((t + 10) * 1e9)); }

  void attitude(double t) {
    const double keep = std::exp(-0.1 / 20);
    for (double& angle : lean_) angle = keep * angle + std::sqrt(1 - keep * keep) * kLean * noise();
    if (silent_) return;
    const Mat3 told = R(t) * so3_exp(lean_ + 1e-3 * noise3() + attitude_lie_);
    odometry_->take(AttitudeReading{ns(t), told.transpose() * Vec3::UnitZ(), kLean});
  }
  void read(ScaleSource source, double t) {
    AidReading r;
    r.source = source;
    r.t_ns = ns(t);
    const Vec3 place = camera(t).t;
    if (source == ScaleSource::kRange) {
      r.sigma_m = 0.05;
      r.value_m.z() = range_bias_ * place.z() / R(t)(2, 2) * -1 + range_lie_;
    } else {
      r.sigma_m = source == ScaleSource::kBarometer ? 0.15 : 0.6;
      r.value_m = place;
    }
    r.value_m += r.sigma_m * noise3();
    odometry_->take(r);
  }
  VisualPose seen(double t) {
    VisualPose pose;
    pose.t_ns = ns(t);
    pose.tracked = tracked_;
    pose.map_id = map_id_;
    const SE3 T = camera(t);
    const double unit = 1e-3;  // of what a picture is off by [map units, rad]
    pose.T_map_cam = {so3_exp(0.1 * unit * noise3()) * R_map_world_ * T.R, in_map(T.t) + unit * noise3()};
    pose.own_covariance = pose.covariance = unit * unit * Mat6::Identity();
    pose.covariance.bottomRightCorner<3, 3>() *= 1e-2;
    pose.own_covariance.bottomRightCorner<3, 3>() *= 1e-2;
    pose.relative_covariance = pose.own_covariance;
    pose.relative_age_ns = rt::kNsPerSecond / 2;
    pose.median_depth = 20 / scale_;
    points_.clear();
    for (int i = 0; i < 24; ++i)
      points_.push_back(in_map(T.t.cwiseProduct(Vec3(1, 1, 0)) + Vec3(8 + i, i % 5 - 2, 0)).cast<float>());
    for (int i = 0; i < 6; ++i) points_.push_back(in_map(Vec3(T.t.x() + 25, i, 1 + i)).cast<float>());
    pose.points = points_;
    return pose;
  }
  /// The picture of time k / 20 s, and what was measured before it.
  MetricPose frame(int k, const std::vector<ScaleSource>& sources) {
    const double t = k / 20.0;
    if (k % 2 == 1) attitude(t - 0.01);
    for (const ScaleSource s : sources)
      if (k % 4 == 3 && k > 3) read(s, t - 0.02);
    VisualPose pose = seen(t);
    if (spoil_) spoil_(&pose);
    const MetricPose told = odometry_->frame(pose);
    if (told.valid && !first_known_) {
      first_known_ = true;
      first_told_ = told.T_nav_cam;
      first_ = camera(t);
    }
    return told;
  }
  Nees off(double t, const MetricPose& told) const {
    const SE3 truth = camera(t);
    const Mat3 D = first_told_.R * first_.R.transpose();
    const Mat3 gauge = so3_exp(Vec3(0, 0, std::atan2(D(1, 0) - D(0, 1), D(0, 0) + D(1, 1))));
    const Vec3 place = gauge * (truth.t - first_.t) - (told.T_nav_cam.t - first_told_.t);
    const Vec3 turn = so3_log(gauge * truth.R * told.T_nav_cam.R.transpose());
    const auto squared = [](const Vec3& e, const Mat3& C) { return e.dot(C.inverse() * e) / 3; };
    return {squared(place, told.covariance.topLeftCorner<3, 3>()),
            squared(turn, told.covariance.bottomRightCorner<3, 3>())};
  }
  /// By which angle the vertical that is told is off [rad].
  double tilt(double t, const MetricPose& told) const {
    return angle_between(told.T_nav_cam.R.row(2).transpose(), camera(t).R.row(2).transpose());
  }

  inline static const Vec3 kUp = Vec3(0.2, -0.9, 0.3).normalized();
  static constexpr double kLean = 0.0175;
  double scale_ = 7, level_after_ = 1e9;
  double range_bias_ = 1, range_lie_ = 0;
  Vec3 attitude_lie_ = Vec3::Zero();
  bool silent_ = false, tracked_ = true;
  std::uint32_t map_id_ = 1;
  CameraMounting mounting_;
  Mat3 R_map_world_;
  std::unique_ptr<AidedOdometry> odometry_;
  void (*spoil_)(VisualPose*) = nullptr;

 private:
  std::mt19937 engine_;
  std::normal_distribution<double> normal_;
  Vec3 lean_ = Vec3::Zero();
  std::vector<Eigen::Vector3f> points_;
  bool first_known_ = false;
  SE3 first_, first_told_;
};

}  // namespace godwit::vo::test
