#include "firmware_app/dynamic/standing_point.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cassert>
#include <cmath>

namespace godwit::app {
namespace {

using vo::Mat3;
using vo::SE3;
using vo::Vec3;

/// Two unit vectors across a unit vector.
Eigen::Matrix<double, 3, 2> across(const Vec3& b) {
  Eigen::Matrix<double, 3, 2> out;
  out.col(0) = b.cross(std::abs(b.x()) < 0.8 ? Vec3::UnitX() : Vec3::UnitY()).normalized();
  out.col(1) = b.cross(out.col(0));
  return out;
}

double swelling(std::span<const Sighting> sightings, const StandingPoint& point) {
  const std::size_t third = sightings.size() / 3;
  double wide = 0.0, high = 0.0;
  for (std::size_t i = 0; i < third; ++i) {
    const Sighting &first = sightings[i], &last = sightings[sightings.size() - 1 - i];
    const double nearer =
        std::log(point.seen_from(last.T_cam_world).norm() / point.seen_from(first.T_cam_world).norm());
    wide += std::log(last.width_rad / first.width_rad) + nearer;
    high += std::log(last.height_rad / first.height_rad) + nearer;
  }
  if (third == 0 || wide * high <= 0.0) return 0.0;
  return std::min(std::abs(wide), std::abs(high)) / static_cast<double>(third);
}

}  // namespace

double StandingPoint::off(const Sighting& s) const {
  return vo::angle_between(seen_from(s.T_cam_world), s.bearing);
}

double baseline_across(std::span<const Sighting> sightings) {
  const Sighting& middle = sightings[sightings.size() / 2];
  const Vec3 from = sightings.front().T_cam_world.centre();
  const Vec3 ray = middle.T_cam_world.R.transpose() * middle.bearing;
  double most = 0.0;
  for (const Sighting& s : sightings) {
    const Vec3 way = s.T_cam_world.centre() - from;
    most = std::max(most, (way - way.dot(ray) * ray).norm());
  }
  return most;
}

Explanation explain(std::span<const Sighting> sightings, double at_inverse_depth) {
  assert(sightings.size() >= 3);
  const Sighting& middle = sightings[sightings.size() / 2];
  const SE3 T_world_mid = middle.T_cam_world.inverse();
  const Eigen::Matrix<double, 3, 2> sideways = across(middle.bearing);
  // The inverse depth is counted in ways of the camera, so that all three unknowns are angles.
  double way = 1e-9;
  for (const Sighting& s : sightings) way = std::max(way, (s.T_cam_world * T_world_mid.t).norm());

  const bool depth_held = at_inverse_depth >= 0.0;
  Vec3 unknown(0.0, 0.0, depth_held ? at_inverse_depth * way : 0.0);
  constexpr int kRounds = 3;  // linear but for the lengths that the angles are measured at
  for (int round = 0; round < kRounds; ++round) {
    Mat3 A = Mat3::Zero();
    Vec3 g = Vec3::Zero();
    for (const Sighting& s : sightings) {
      const SE3 T = s.T_cam_world * T_world_mid;
      const Vec3 p = T.R * (middle.bearing + sideways * unknown.head<2>()) + unknown.z() / way * T.t;
      const double length = std::max(p.norm(), 0.1);
      const Eigen::Matrix<double, 2, 3> onto = across(s.bearing).transpose() / length;
      Eigen::Matrix<double, 2, 3> J;
      J.leftCols<2>() = onto * T.R * sideways;
      J.col(2) = depth_held ? vo::Vec2(vo::Vec2::Zero()) : vo::Vec2(onto * T.t / way);
      A += J.transpose() * J;
      g += J.transpose() * (onto * p);
    }
    // A camera on its way towards the thing tells nothing of its depth: the step stays bounded.
    A.diagonal().array() += 1e-9;
    unknown -= A.ldlt().solve(g);
  }
  Explanation out;
  out.inverse_depth = unknown.z() / way;
  const Vec3 direction = middle.bearing + sideways * unknown.head<2>();
  out.point.weight = out.inverse_depth;
  out.point.direction = T_world_mid.R * direction + out.point.weight * T_world_mid.t;
  for (const Sighting& s : sightings) out.worst_rad = std::max(out.worst_rad, out.point.off(s));
  out.swelling = swelling(sightings, out.point);
  return out;
}

}  // namespace godwit::app
