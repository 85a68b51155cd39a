// A flight through frames ("children") that lie anywhere, as NavigationFrame hears of it.
#pragma once

#include <cmath>

#include "tests/vo_core/inertial_flight.h"
#include "vo_core/inertial/navigation_frame.h"

namespace godwit::vo::test {

inline constexpr double kPlaceNoise = 3e-3, kTurnNoise = 2e-3, kSpeedNoise = 0.02;
inline constexpr double kGyroBiasNoise = 1e-3, kAccelBiasNoise = 0.02;

/// Seen 20 times and felt 200 times a second.
class NavigationFlown {
 public:
  explicit NavigationFlown(unsigned seed, const NavigationOptions& options = {})
      : flight_(1.0, seed), navigation_(flight_.mounting_.t_body_cam_m, options) {
    bias_ = flight_.bias_;
    bias_.gyro += kGyroBiasNoise * flight_.random();
    bias_.accel += kAccelBiasNoise * flight_.random();
  }
  /// Another child frame: where and how it lies is drawn.
  void new_child() {
    ++child_id_;
    child_at_ = 20 * flight_.random();
    child_turn_ = so3_exp(Vec3(0, 0, 2 * flight_.random().x()));
  }
  Vec3 camera(double t) const { return flight_.p(t) + flight_.R(t) * flight_.mounting_.t_body_cam_m; }
  Mat3 attitude(double t) const { return flight_.R(t) * flight_.mounting_.R_body_cam; }
  Vec3 speed(double t) const { return (camera(t + 1e-4) - camera(t - 1e-4)) / 2e-4; }

  MetricMoment moment(double t) {
    MetricMoment m;
    m.child_id = child_id_;
    const Mat3 R = child_turn_.transpose();
    m.T_child_cam = {R * so3_exp(kTurnNoise * flight_.random()) * attitude(t),
                     R * (camera(t) - child_at_) + kPlaceNoise * flight_.random()};
    m.velocity_m_s = R * speed(t) + kSpeedNoise * flight_.random();
    m.covariance.diagonal() << Vec3::Constant(kPlaceNoise * kPlaceNoise), Vec3::Constant(kTurnNoise * kTurnNoise);
    m.velocity_covariance = kSpeedNoise * kSpeedNoise * Mat3::Identity();
    m.bias = bias_;
    m.gyro_bias_sigma = kGyroBiasNoise;
    m.accel_bias_sigma = kAccelBiasNoise;
    m.R_body_cam = flight_.mounting_.R_body_cam;
    return m;
  }
  void feel(int k) {
    for (int i = 1; i <= 10; ++i) {
      ImuReading r = flight_.reading(k / 20.0 - 0.05 + i / 200.0);
      r.gyro_rad_s += flight_.model_.imu.gyro * std::sqrt(200.0) * flight_.random();
      r.accel_m_s2 += flight_.model_.imu.accel * std::sqrt(200.0) * flight_.random();
      navigation_.add(r);
      if (readings_ != nullptr) readings_->add(r);
    }
  }
  NavigationPose frame(int k, bool seen = true) {
    if (!silent_) feel(k);
    MetricMoment m = moment(k / 20.0);
    if (spoil_) spoil_(&m);
    const NavigationPose out = navigation_.frame(time(k), seen ? &m : nullptr);
    // The navigation frame is the first child: into it goes the truth.
    if (k == 0) first_ = {child_turn_, child_at_};
    return out;
  }
  static rt::TimeNs time(int k) { return k * rt::TimeNs{50'000'000}; }
  /// The first child's origin and heading are the frame's: the truth in it.
  Vec3 true_place(int k) const { return first_.R.transpose() * (camera(k / 20.0) - first_.t); }
  Vec3 true_speed(int k) const { return first_.R.transpose() * speed(k / 20.0); }
  Vec6 error(int k, const NavigationPose& pose) const { return error_at(k / 20.0, pose.T_nav_cam); }
  Vec6 error_at(double t, const SE3& T_nav_cam) const {
    Vec6 e;
    e << first_.R.transpose() * (camera(t) - first_.t) - T_nav_cam.t,
        so3_log(first_.R.transpose() * attitude(t) * T_nav_cam.R.transpose());
    return e;
  }

  Flight flight_;
  NavigationFrame navigation_;
  ImuBias bias_;
  ImuBuffer* readings_ = nullptr;  ///< hears what navigation_ hears
  bool silent_ = false;
  void (*spoil_)(MetricMoment*) = nullptr;

 private:
  std::uint32_t child_id_ = 1;
  Vec3 child_at_ = Vec3(3, -2, 1);
  Mat3 child_turn_ = so3_exp(Vec3(0, 0, 0.7));
  SE3 first_;
};

}  // namespace godwit::vo::test
