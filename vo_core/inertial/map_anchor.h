// Where a map became metric, and how it hangs from there: from vision's unit and slant to a frame in metres, z up, and
// what an error of scale and vertical does to a pose in it.
#pragma once

#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

/// What vision says of a pose in its map.
struct MapPose {
  SE3 T_map_cam;
  Mat6 covariance = Mat6::Zero();      ///< of the left twist (v, w) of T_cam_map, map units and rad
  Mat6 own_covariance = Mat6::Zero();  ///< the same of this picture's own matches alone
};

/// Plain value; no allocation.
class MapAnchor {
 public:
  /// Here the map begins to be metric. up: along the map's axes, unit length. The heading is that of the camera's last
  /// pose, and so is the place; without one (null) the camera looks along x, at the origin.
  void begin(const MapPose& pose, const Vec3& up, const SE3* last_nav);
  /// The least turn that brings the map's vertical up; it leaves the heading alone.
  void level(const Vec3& up);

  const Mat3& R_nav_map() const { return R_nav_map_; }
  /// scale: metres in a map unit.
  SE3 in_nav(const SE3& T_map_cam, double scale) const;
  SE3 in_map(const SE3& T_nav_cam, double scale) const;  ///< the same back

  /// How place and attitude (rotation vector, both along the frame's axes) answer to errors of the logarithm of the
  /// scale and of the vertical about the frame's x and y: all moves and tilts about the anchor. way: from there [m].
  static Eigen::Matrix<double, 6, 3> shared_errors(const Vec3& way);
  /// The way from the anchor [m].
  Vec3 way(const SE3& T_map_cam, double scale) const { return scale * (R_nav_map_ * (T_map_cam.t - anchor_map_.t)); }
  /// Vision's own: covariance of (place [m], rotation vector) along the frame's axes, without what was wrong at the
  /// anchor already: that is in the frame's origin and heading. strayed2: what places strayed by since the anchor, if
  /// others know that [map units^2, an axis]. The tracker's word and that one are of the same walk: of the two the
  /// larger along each axis counts, and this picture's own noise comes on top.
  Mat6 grown(const MapPose& pose, double scale, double strayed2 = 0) const;

 private:
  Mat3 R_nav_map_ = Mat3::Identity();
  SE3 anchor_map_;  ///< the anchor's, camera to map
  Vec3 anchor_nav_ = Vec3::Zero();
  Mat6 anchor_covariance_ = Mat6::Zero();
};

}  // namespace godwit::vo
