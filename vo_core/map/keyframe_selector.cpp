#include "vo_core/map/keyframe_selector.h"

#include <algorithm>
#include <cmath>

namespace godwit::vo {

void compare_with_keyframes(const KeyframeSelectorOptions& o, const Map& map, const SE3& T_cam_world,
                            double median_depth, std::uint32_t last_id, KeyframeFigures* f) {
  f->keyframes = map.keyframe_count();
  f->nearest_distance = f->nearest_angle_rad = KeyframeFigures::kNone;
  const Vec3 position = -(T_cam_world.R.transpose() * T_cam_world.t);
  for (int k = 0; k < kMaxKeyframes; ++k) {
    const Keyframe& kf = map.keyframe(k);
    if (kf.id == 0) continue;
    const double distance = (kf.position() - position).norm() / median_depth;
    // Of the whole rotation: rolled about the optical axis a picture sees other things at its corners, too.
    const double twice_cos = kf.T_kf_world.R.cwiseProduct(T_cam_world.R).sum() - 1.0;
    const double angle = std::acos(std::clamp(0.5 * twice_cos, -1.0, 1.0));
    // A keyframe that looks elsewhere is no near one.
    if (angle < o.min_angle_rad) f->nearest_distance = std::min(f->nearest_distance, distance);
    if (distance < o.min_distance) f->nearest_angle_rad = std::min(f->nearest_angle_rad, angle);
    if (kf.id == last_id) {
      f->last_distance = distance;
      f->last_angle_rad = angle;
    }
  }
}

}  // namespace godwit::vo
