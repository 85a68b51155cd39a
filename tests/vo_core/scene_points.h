// Point scenes with exact truth, seen by two or more views, for the tests of the geometry.
#pragma once

#include <random>
#include <vector>

#include "vo_core/geometry/geometry.h"

namespace godwit::vo::scenes {

enum class Scene { kPlane, kGeneral };

/// Points in front of the first view, in its frame, within its field of view (about 60 degrees wide).
inline std::vector<Vec3> make_points(Scene scene, int n, std::mt19937* random) {
  std::uniform_real_distribution<double> side(-0.55, 0.55), depth(1.5, 5.0);
  std::vector<Vec3> points;
  for (int i = 0; i < n; ++i) {
    const double x = side(*random), y = 0.75 * side(*random);
    // The plane 0.3 X + 0.2 Y + Z = 3.
    const double z = scene == Scene::kPlane ? 3.0 / (0.3 * x + 0.2 * y + 1.0) : depth(*random);
    points.emplace_back(x * z, y * z, z);
  }
  return points;
}

/// Where the points appear on the plane z = 1 of a view, with noise.
inline std::vector<Vec2> observe(const std::vector<Vec3>& points, const SE3& T, double noise, std::mt19937* random) {
  std::normal_distribution<double> error(0.0, 1.0);
  std::vector<Vec2> xy;
  for (const Vec3& p : points) {
    const Vec3 q = T * p;
    xy.emplace_back(q.x() / q.z() + noise * error(*random), q.y() / q.z() + noise * error(*random));
  }
  return xy;
}

/// Replaces every k-th observation by a random one. share in [0, 1).
inline void spoil(double share, std::vector<Vec2>* xy, std::mt19937* random) {
  std::uniform_real_distribution<double> side(-0.6, 0.6), coin(0.0, 1.0);
  for (Vec2& p : *xy)
    if (coin(*random) < share) p = Vec2(side(*random), side(*random));
}

inline std::vector<Vec2> scaled(const std::vector<Vec2>& xy, double s) {
  std::vector<Vec2> out = xy;
  for (Vec2& p : out) p *= s;
  return out;
}

inline double direction_error_deg(const SE3& a, const SE3& b) {
  return std::acos(std::min(1.0, a.t.normalized().dot(b.t.normalized()))) * 180.0 / M_PI;
}
inline double rotation_error_deg(const SE3& a, const SE3& b) {
  return so3_log(a.R.transpose() * b.R).norm() * 180.0 / M_PI;
}

}  // namespace godwit::vo::scenes
