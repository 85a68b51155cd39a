// How the camera has turned from one picture to the next, before that is tracked: as it turned before.
#pragma once

#include <cstdint>

#include "detector/box_carrier.h"
#include "hal/rt/time.h"
#include "vo_core/geometry/camera_model.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::app {

/// Constant angular velocity, from the newest two tracked frames of a map. One thread; no allocation.
class CameraTurn {
 public:
  /// Poses older than this say nothing of now.
  static constexpr rt::TimeNs kStaleNs = 150 * rt::kNsPerMs;

  explicit CameraTurn(const vo::CameraModel& camera) : camera_(camera) {}

  /// A frame was tracked; times of one map rise from call to call.
  void note_tracked(rt::TimeNs t_capture_ns, std::uint32_t map_id, const vo::SE3& T_cam_world);

  /// What the turn from the picture of the last call to this one does to far points: K R K^-1, without distortion.
  /// Identity where it is not known: at the first call, and without two tracked frames no older than kStaleNs.
  detector::CameraMotion next(rt::TimeNs t_capture_ns);

 private:
  const vo::CameraModel camera_;
  rt::TimeNs t_picture_ns_ = 0, t_tracked_ns_ = 0;
  bool have_picture_ = false, have_pose_ = false, have_rate_ = false;
  std::uint32_t map_id_ = 0;
  vo::Mat3 R_cam_world_ = vo::Mat3::Identity();
  vo::Vec3 rate_ = vo::Vec3::Zero();  ///< rotation vector of camera to later camera, a second [rad/s]
};

}  // namespace godwit::app
