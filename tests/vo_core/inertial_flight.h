// A flight for tests of what is inertial: a motion known exactly, seen in a slanted map of another scale, felt by a
// noisy sensor.
#pragma once

#include <algorithm>
#include <cmath>
#include <random>

#include "vo_core/inertial/inertial_smoother.h"

namespace godwit::vo::test {

const Vec3 kUpInMap = Vec3(0.2, -0.9, 0.3).normalized();

inline CameraMounting slanted_mounting() {
  return {so3_exp(Vec3(0.3, 1.2, -0.5)), Vec3(0.1, -0.05, 0.07)};
}

/// A hand-held motion in a map with another scale and a slanted vertical, seen 20 times and felt 200 times a second.
class Flight {
 public:
  Flight(double amplitude, unsigned seed) : amplitude_(amplitude), engine_(seed) {
    bias_.gyro = 0.03 * random();
    bias_.accel = 0.08 * random();
    // Any rotation that takes z up to the map's vertical.
    const Vec3 axis = Vec3(0, 0, 1).cross(kUpInMap);
    R_map_world_ = so3_exp(axis.normalized() * std::atan2(axis.norm(), kUpInMap.z()));
  }
  Mat3 R(double t) const {
    t = moved_until(t);
    const double a = std::min(1.0, amplitude_);
    return so3_exp(a * Vec3(0.3 * std::sin(1.7 * t), 0.4 * std::sin(1.1 * t + 1), 0.6 * std::sin(0.7 * t)));
  }
  Vec3 p(double t) const {
    const double after = std::max(0.0, t - stops_at_);
    // From standstill to so fast within two seconds, without a jerk at either end.
    const double x = std::min(after, 2.0) / 2, begun = 2 * (x * x * x - x * x * x * x / 2) + std::max(0.0, after - 2);
    const Vec3 sway(std::sin(0.9 * after), std::sin(1.3 * after + 1) - std::sin(1.0), std::sin(0.7 * after));
    const double begins = x * x * x * (10 - 15 * x + 6 * x * x);
    const Vec3 later = begun * cruises_ * Vec3(0.8, 0.6, 0) + begins * sways_ * sway;
    t = moved_until(t);
    return later + amplitude_ * Vec3(0.4 * std::sin(1.9 * t), 0.3 * std::cos(2.3 * t), 0.2 * std::sin(1.5 * t + 2));
  }
  /// Until rests_until_ it has not begun, and takes a second to; after stops_at_ it comes to rest within a second.
  double moved_until(double t) const {
    if (rests_until_ > 0) {
      const double begun = std::max(0.0, t - rests_until_), x = std::min(begun, 1.0);
      return begun - x + x * x * x - x * x * x * x / 2;
    }
    if (t <= stops_at_) return t;
    const double x = std::min(t - stops_at_, 1.0);
    return stops_at_ + x - x * x * x + x * x * x * x / 2;
  }
  Vec3 v(double t) const { return (p(t + kStep) - p(t - kStep)) / (2 * kStep); }
  Vec3 a(double t) const { return (p(t + kStep) - 2 * p(t) + p(t - kStep)) / (kStep * kStep); }

  /// The moment k / 20 s.
  InertialNode node(int k, const ImuBias& guess) {
    InertialNode n;
    const double t = k / 20.0;
    n.t_ns = static_cast<rt::TimeNs>(t * 1e9);
    const double root = std::sqrt(1 / 20.0);
    drift_ = 0.95 * drift_ + root * model_.position_walk * random();
    turn_ = 0.95 * turn_ + root * model_.rotation_walk * random();
    n.sight.R_map_cam = so3_exp(turn_) * R_map_world_ * R(t) * mounting_.R_body_cam;
    const Vec3 camera = p(t) + R(t) * mounting_.t_body_cam_m;
    // As new things come into view a map's unit becomes another one.
    if (scale_walks_ > 0 && k > 0) {
      const double walked = t > stops_at_ ? 1 : 0;
      strayed_scale_ += walked * root * scale_walks_ * random().x();
      strayed_ += R_map_world_ * (camera - last_camera_) / scale_ * (std::exp(-strayed_scale_) - 1);
    }
    last_camera_ = camera;
    n.sight.camera = R_map_world_ * camera / scale_ + drift_ + strayed_;
    n.since_last = Preintegration(guess);
    for (int i = 0; i < 10 && k > 0; ++i) {
      const double m = t - 1 / 20.0 + (i + 0.5) / 200;
      const double rate = std::sqrt(200.0);
      const Vec3 gyro = so3_log(R(m - 1e-4).transpose() * R(m + 1e-4)) / 2e-4 + bias_.gyro;
      const Vec3 accel = R(m).transpose() * (a(m) + Vec3(0, 0, kStandardGravity)) + bias_.accel;
      n.sight.gyro_rad_s = gyro;
      n.since_last.add(gyro + model_.imu.gyro * rate * random(), accel + model_.imu.accel * rate * random(), 0.005,
                       model_.imu);
    }
    return n;
  }
  /// What the sensor reads at t_s, without its white noise.
  ImuReading reading(double t_s) const {
    return {static_cast<rt::TimeNs>(std::llround(t_s * 1e9)),
            so3_log(R(t_s - 1e-4).transpose() * R(t_s + 1e-4)) / 2e-4 + bias_.gyro,
            R(t_s).transpose() * (a(t_s) + Vec3(0, 0, kStandardGravity)) + bias_.accel};
  }

  Vec3 random() { return Vec3(normal_(engine_), normal_(engine_), normal_(engine_)); }

  /// Vision as it is where the scene is some way off.
  static InertialModel quiet() {
    InertialModel m;
    m.rotation_walk = 1e-3;
    m.rotation_sigma = 3e-3;
    m.position_walk = 6e-4;
    m.position_sigma = 3e-3;
    m.scale_walk = 3e-4;
    return m;
  }

  static constexpr double kStep = 1e-4;
  double amplitude_, scale_ = 2.5;
  double rests_until_ = 0, stops_at_ = 1e9;  ///< [s]; one of the two
  double cruises_ = 0;                       ///< after stops_at_ so fast and straight on [m/s]
  double sways_ = 0;                         ///< or it hovers, and sways by so much [m]
  double scale_walks_ = 0;                   ///< of the map's scale, as it flies [1/sqrt(s)]
  double strayed_scale_ = 0;                 ///< by now, of its logarithm
  ImuBias bias_;
  CameraMounting mounting_ = slanted_mounting();
  InertialModel model_ = quiet();
  Mat3 R_map_world_;

 private:
  std::mt19937 engine_;
  std::normal_distribution<double> normal_;
  Vec3 drift_ = Vec3::Zero(), turn_ = Vec3::Zero(), strayed_ = Vec3::Zero(), last_camera_ = Vec3::Zero();
};

}  // namespace godwit::vo::test
