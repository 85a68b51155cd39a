// Small linear-algebra vocabulary of the odometry: vectors, SE(3), SO(3). All fixed-size, no allocation.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>

namespace godwit::vo {

using Vec2 = Eigen::Vector2d;
using Vec3 = Eigen::Vector3d;
using Vec6 = Eigen::Matrix<double, 6, 1>;
using Mat3 = Eigen::Matrix3d;
using Mat6 = Eigen::Matrix<double, 6, 6>;
using Mat23 = Eigen::Matrix<double, 2, 3>;
using Mat26 = Eigen::Matrix<double, 2, 6>;
using Vec2f = Eigen::Vector2f;
using Vec3f = Eigen::Vector3f;

/// Angle between two vectors of any length [rad], 0 to pi; exact for small ones too.
inline double angle_between(const Vec3& a, const Vec3& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

inline Mat3 skew(const Vec3& v) {
  Mat3 m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

/// Rotation matrix of the rotation vector w [rad] (Rodrigues).
inline Mat3 so3_exp(const Vec3& w) {
  const double theta2 = w.squaredNorm();
  const Mat3 W = skew(w);
  if (theta2 < 1e-12) return Mat3::Identity() + W + 0.5 * W * W;
  const double theta = std::sqrt(theta2);
  return Mat3::Identity() + (std::sin(theta) / theta) * W + ((1.0 - std::cos(theta)) / theta2) * W * W;
}

/// Rotation vector [rad] of a rotation matrix, norm in [0, pi].
inline Vec3 so3_log(const Mat3& R) {
  const Eigen::AngleAxisd a(R);
  return a.angle() * a.axis();
}

/// Rigid motion. T_a_b maps points of frame b into frame a: p_a = T_a_b * p_b.
struct SE3 {
  Mat3 R = Mat3::Identity();
  Vec3 t = Vec3::Zero();

  SE3() = default;
  SE3(const Mat3& rotation, const Vec3& translation) : R(rotation), t(translation) {}

  Vec3 operator*(const Vec3& p) const { return R * p + t; }
  SE3 operator*(const SE3& o) const { return {R * o.R, R * o.t + t}; }
  SE3 inverse() const { return {R.transpose(), centre()}; }
  /// Of T_cam_world: where the camera is in the world. The translation of the inverse.
  Vec3 centre() const { return -(R.transpose() * t); }
  Eigen::Quaterniond quaternion() const { return Eigen::Quaterniond(R).normalized(); }

  /// Twist x = (v [translation], w [rad]) -> motion: R = exp(w), t = V(w) v.
  static SE3 exp(const Vec6& x) {
    const Vec3 v = x.head<3>(), w = x.tail<3>();
    const double theta2 = w.squaredNorm();
    double a = 0.5, b = 1.0 / 6.0;
    if (theta2 > 1e-12) {
      const double theta = std::sqrt(theta2);
      a = (1.0 - std::cos(theta)) / theta2;
      b = (theta - std::sin(theta)) / (theta2 * theta);
    }
    const Vec3 wv = w.cross(v);
    return {so3_exp(w), v + a * wv + b * w.cross(wv)};
  }

  /// Inverse of exp: twist (v, w).
  Vec6 log() const {
    const Vec3 w = so3_log(R);
    const double theta2 = w.squaredNorm();
    double c = 1.0 / 12.0;
    if (theta2 > 1e-12) {
      const double theta = std::sqrt(theta2);
      const double half = 0.5 * theta;
      c = (1.0 - half * std::cos(half) / std::sin(half)) / theta2;
    }
    Vec6 x;
    const Vec3 wt = w.cross(t);
    x << (t - 0.5 * wt + c * w.cross(wt)), w;
    return x;
  }

  /// Puts R back onto SO(3) after many products.
  void normalize() { R = Eigen::Quaterniond(R).normalized().toRotationMatrix(); }
};

}  // namespace godwit::vo
