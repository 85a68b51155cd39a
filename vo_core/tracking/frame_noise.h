// What one frame's own noise makes of its pose, from the residuals that the pose leaves (residual_spread.h).
#pragma once

#include <algorithm>
#include <span>

#include "vo_core/geometry/camera_model.h"
#include "vo_core/tracking/pose_optimizer.h"

namespace godwit::vo {

/// Of the left twist (v, w) of T_cam_world, the map taken for true [map units, rad].
struct FrameCovariance {
  Mat6 noise = Mat6::Identity();  ///< of the measurements
  /// Where the camera was at the capture time against where a constant velocity through the readout has it. Zero with a
  /// global shutter.
  Mat6 strayed = Mat6::Zero();
};

/// Tracker thread. No allocation.
class FrameNoise {
 public:
  explicit FrameNoise(bool rolling_shutter) : rolling_(rolling_shutter) {}
  void reset() { sums_ = independent_ = squares_ = alike_ = alike_square_ = weight_ = shake_ = 0.0; }

  /// By how much a camera that shakes within a readout has whole rows of a picture stray from where the pose has them:
  /// the variance of a coordinate, in units of a measurement's own. What strays on one side only is something that
  /// moves, and what three sigmas of its mean over the last second do not tell from nothing is none. A measurement's
  /// variance is 1 + shake() times what the patch alone makes of it, and is to be stated as that. 0 with a global
  /// shutter.
  double shake() const { return shake_; }
  /// How many times a picture's measurements together are less sure than if they were independent.
  double correlated() const { return independent_ > 0.0 ? std::max(1.0, sums_ / independent_) : 1.0; }

  /// Of the pose that minimises Tukey's biweight of the measurements' residuals over `weight_scale` stated sigmas
  /// (pose_optimizer.h); their sigmas are as shake() says. Bounded by the measurements. Identity when they do not
  /// determine the pose.
  FrameCovariance covariance(const CameraModel& camera, std::span<const PoseMeasurement> measurements,
                             const SE3& T_cam_world, double weight_scale);

 private:
  bool rolling_;
  // What one picture tells of its bands hangs on a dozen sums: averaged over the last second or so.
  double sums_ = 0.0, independent_ = 0.0, squares_ = 0.0;
  double alike_ = 0.0, alike_square_ = 0.0, weight_ = 0.0;  // of one picture's shake
  double shake_ = 0.0;
};

}  // namespace godwit::vo
