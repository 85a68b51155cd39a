// Rolling shutter, to first order in the camera's motion over one readout (Ait-Aider et al., ECCV 2006, the constant-
// velocity model), and beside that the turns that a gyroscope has measured row by row: what a picture read row by row
// shows, against what a global shutter would have seen at the frame's capture time.
#pragma once

#include <algorithm>
#include <array>

#include "vo_core/geometry/camera_model.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

struct RollingShutter {
  double readout_s = 0.0;  ///< first to last row; 0: global shutter
  double reference = 0.5;  ///< row, as a share of the height, that is read at the capture time
};

/// Something of a camera that turns within one readout, along the camera's axes at evenly spaced rows.
struct RowTurns {
  /// What shakes an aircraft at 100 Hz turns once within 10 ms: a dozen rows for that.
  static constexpr int kRows = 24;
  std::array<Vec3f, kRows> at;  ///< from the first row to the last

  /// Between two of them by a straight line. share: of the picture's height.
  Vec3 turn(double share) const {
    const double place = std::clamp(share, 0.0, 1.0) * (kRows - 1);
    const int row = std::min(static_cast<int>(place), kRows - 2);
    const auto x = static_cast<float>(place - row);
    return ((1.0f - x) * at[row] + x * at[row + 1]).cast<double>();
  }
};

/// How the camera moved while a picture was read.
struct ReadoutMotion {
  Vec6 velocity = Vec6::Zero();  ///< left twist rate (v, w) of T_cam_world [map units / s, rad / s]
  /// Beside the steady turn: rotation vectors of T_cam_world against the capture time [rad]; their mean is none. Counts
  /// only where it `shakes`.
  RowTurns shake;
  bool shakes = false;

  /// The ray of a point, that was seen at this share of the height, as it would be without the shake.
  Vec3 steadied(double share, const Vec3& ray) const { return shakes ? Vec3(ray - shake.turn(share).cross(ray)) : ray; }
  /// By what a point that lies at p_cam at the capture time lies elsewhere when a row is read.
  Vec3 moved(const RollingShutter& shutter, double share, const Vec3& p_cam) const {
    const double tau = (share - shutter.reference) * shutter.readout_s;
    const Vec3 steady = tau * (velocity.head<3>() + velocity.tail<3>().cross(p_cam));
    return shakes ? Vec3(steady + shake.turn(share).cross(p_cam)) : steady;
  }
};

/// Row displacement [px] that the rolling readout adds to the pixel of a point: seen = global + displacement.
/// p_cam: the point in the camera frame at capture time; J: d pixel / d p_cam there; row: where it is seen [px].
inline Vec2 rolling_displacement(const RollingShutter& shutter, int height, const Vec3& p_cam, const Mat23& J,
                                 double row, const ReadoutMotion& motion) {
  return J * motion.moved(shutter, row / height, p_cam);
}

/// Where a global shutter would have seen the point that was seen at `px` [px] and lies at p_cam in the camera frame at
/// capture time; px itself where p_cam does not project. No allocation.
inline Vec2f global_pixel(const RollingShutter& shutter, const CameraModel& camera, const Vec2f& px, const Vec3& p_cam,
                          const ReadoutMotion& motion) {
  Vec2 unused;
  Mat23 J;
  if (shutter.readout_s <= 0.0 || !camera.project(p_cam, &unused, &J)) return px;
  const Vec2 moved = rolling_displacement(shutter, camera.height(), p_cam, J, static_cast<double>(px.y()), motion);
  return px - moved.cast<float>();
}

}  // namespace godwit::vo
