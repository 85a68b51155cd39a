#include "firmware_app/dynamic/camera_turn.h"

namespace godwit::app {

void CameraTurn::note_tracked(rt::TimeNs t_capture_ns, std::uint32_t map_id, const vo::SE3& T_cam_world) {
  const rt::TimeNs step = t_capture_ns - t_tracked_ns_;
  have_rate_ = have_pose_ && map_id == map_id_ && step > 0 && step <= kStaleNs;
  if (have_rate_) rate_ = vo::so3_log(T_cam_world.R * R_cam_world_.transpose()) / rt::to_seconds(step);
  have_pose_ = true;
  t_tracked_ns_ = t_capture_ns;
  map_id_ = map_id;
  R_cam_world_ = T_cam_world.R;
}

detector::CameraMotion CameraTurn::next(rt::TimeNs t_capture_ns) {
  detector::CameraMotion out;
  const rt::TimeNs step = t_capture_ns - t_picture_ns_;
  const bool known = have_picture_ && have_rate_ && step > 0 && t_capture_ns - t_tracked_ns_ <= kStaleNs;
  t_picture_ns_ = t_capture_ns;
  have_picture_ = true;
  if (!known) return out;
  vo::Mat3 K = vo::Mat3::Identity();
  K.diagonal() << camera_.fx(), camera_.fy(), 1.0;
  K.col(2).head<2>() << camera_.cx(), camera_.cy();
  const vo::Mat3 H = K * vo::so3_exp(rate_ * rt::to_seconds(step)) * K.inverse();
  for (int row = 0; row < 3; ++row)
    for (int column = 0; column < 3; ++column)
      out.far_homography[3 * row + column] = static_cast<float>(H(row, column));
  return out;
}

}  // namespace godwit::app
