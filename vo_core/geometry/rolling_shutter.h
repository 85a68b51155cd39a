// Rolling shutter, to first order in the camera's velocity over one readout (Ait-Aider et al., ECCV 2006, the constant-
// velocity model): what a picture read row by row shows, against what a global shutter would have seen at the frame's
// capture time.
#pragma once

#include "vo_core/geometry/camera_model.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

struct RollingShutter {
  double readout_s = 0.0;  ///< first to last row; 0: global shutter
  double reference = 0.5;  ///< row, as a share of the height, that is read at the capture time
};

/// Row displacement [px] that the rolling readout adds to the pixel of a point: seen = global + displacement.
/// p_cam: the point in the camera frame at capture time; J: d pixel / d p_cam there; row: where it is seen [px];
/// velocity: left twist rate (v, w) of T_cam_world [map units / s, rad / s].
inline Vec2 rolling_displacement(const RollingShutter& shutter, int height, const Vec3& p_cam, const Mat23& J,
                                 double row, const Vec6& velocity) {
  const double tau = (row / height - shutter.reference) * shutter.readout_s;
  return J * (tau * (velocity.head<3>() + velocity.tail<3>().cross(p_cam)));
}

/// Where a global shutter would have seen the point that was seen at `px` [px] and lies at p_cam in the camera frame at
/// capture time; px itself where p_cam does not project. No allocation.
inline Vec2f global_pixel(const RollingShutter& shutter, const CameraModel& camera, const Vec2f& px, const Vec3& p_cam,
                          const Vec6& velocity) {
  Vec2 unused;
  Mat23 J;
  if (shutter.readout_s <= 0.0 || !camera.project(p_cam, &unused, &J)) return px;
  const Vec2 moved = rolling_displacement(shutter, camera.height(), p_cam, J, static_cast<double>(px.y()), velocity);
  return px - moved.cast<float>();
}

}  // namespace godwit::vo
