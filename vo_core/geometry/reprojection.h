// What one observation of a map point is off by, and how that changes with the pose and with the point: the residual
// that bundle adjustment and structure optimisation share.
#pragma once

#include "vo_core/geometry/camera_model.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

/// A map point's place in a picture, freed of the rolling shutter.
struct ImageObservation {
  Vec2 px = Vec2::Zero();         ///< level-0 px
  Vec2 gradient = Vec2::UnitX();  ///< edgelets: unit direction in which it counts
  double inv_sigma = 1.0;         ///< one over the stated sigma of each coordinate [1/px]
  bool edgelet = false;
};

/// Measured less predicted place, in stated sigmas; of an edgelet the part along its gradient, (r, 0). J_point, J_pose:
/// derivatives of the prediction (the residual's with the other sign) by p_world and by the left twist (v, w) of
/// T_cam_world; either may be null, J_pose only with J_point. False, and nothing set, if the point cannot be seen.
inline bool reprojection_residual(const CameraModel& camera, const ImageObservation& o, const SE3& T_cam_world,
                                  const Vec3& p_world, Vec2* r, Mat23* J_point = nullptr, Mat26* J_pose = nullptr) {
  const Vec3 p_cam = T_cam_world * p_world;
  Vec2 px;
  Mat23 J;
  if (!camera.project(p_cam, &px, J_point ? &J : nullptr)) return false;
  *r = (o.px - px) * o.inv_sigma;
  if (J_point) J *= o.inv_sigma;
  if (o.edgelet) {
    *r = Vec2(o.gradient.dot(*r), 0.0);
    if (J_point) {
      J.row(0) = o.gradient.transpose() * J;
      J.row(1).setZero();
    }
  }
  if (J_point) *J_point = J * T_cam_world.R;
  if (J_pose) {
    J_pose->leftCols<3>() = J;
    J_pose->rightCols<3>() = -J * skew(p_cam);
  }
  return true;
}

}  // namespace godwit::vo
