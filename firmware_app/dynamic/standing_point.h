// Does one point that stands in the world explain where a thing was seen from several poses?
#pragma once

#include <span>

#include "hal/rt/time.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::app {

/// A thing as one picture showed it.
struct Sighting {
  rt::TimeNs t_ns = 0;
  vo::SE3 T_cam_world;
  vo::Vec3 bearing = vo::Vec3::UnitZ();  ///< of its centre, unit vector in the camera
  double width_rad = 0.0, height_rad = 0.0;

  double side_rad() const { return width_rad < height_rad ? width_rad : height_rad; }
};

/// World point in homogeneous form (direction + weight): a weight of zero lies at infinity.
struct StandingPoint {
  vo::Vec3 direction = vo::Vec3::UnitZ();
  double weight = 0.0;

  /// Towards the point, in the camera: its length times the distance is the same from every pose.
  vo::Vec3 seen_from(const vo::SE3& T_cam_world) const { return T_cam_world.R * direction + weight * T_cam_world.t; }
  /// Angle between where it is and where it was seen [rad].
  double off(const Sighting& s) const;
};

/// How well a point explains the sightings.
struct Explanation {
  StandingPoint point;
  double worst_rad = 0.0;      ///< largest angle between a centre seen and the point
  double inverse_depth = 0.0;  ///< of the point, seen from the middle sighting; negative: no place could be that
  /// Both sides grew or shrank beyond what the distances explain, by this share, from the first third of the sightings
  /// to the last. One side alone may: the thing is seen from another side.
  double swelling = 0.0;
};

/// Largest way of the camera across the line of sight between two of the sightings, as seen from the middle one [map
/// units]; what depth can be told by. Precondition: not empty. No allocation.
double baseline_across(std::span<const Sighting> sightings);

/// Least squares over the point's direction and inverse depth; with `at_inverse_depth` >= 0 the depth is held there and
/// the direction alone is sought. Precondition: at least three sightings. No allocation, bounded.
Explanation explain(std::span<const Sighting> sightings, double at_inverse_depth = -1.0);

}  // namespace godwit::app
