// How much of what a gyroscope says of a camera's shaking its pictures show: a rolling shutter reads each row at
// another time, and what the camera turns between them beside its steady motion moves whole rows by up to a pixel.
#pragma once

#include <array>
#include <span>

#include "hal/rt/time.h"
#include "vo_core/features/initial_tracks.h"
#include "vo_core/geometry/rolling_shutter.h"
#include "vo_core/tracking/pose_optimizer.h"

namespace godwit::vo {

/// What the gyroscope says of a picture's readout, along the camera's axes, the steady turn since the picture before
/// and the mean over the rows taken off: the turn of T_cam_world at each row against the capture time [rad], and how
/// fast it turns there [rad/s].
struct MeasuredShake {
  bool known = false;
  rt::TimeNs t_ns = 0;  ///< of the middle row
  RowTurns turn, rate;
};

/// The sensor may sit elsewhere than the camera, behind a low-pass and late: what shakes the camera is what it read
/// times a gain, and how fast that turned times a time, two figures that stay. They are found by least squares of what
/// the rows of the pictures are off by; until these show it both sit on one rigid body, and nothing is late. Where the
/// pictures do not shake as the sensor does the gain becomes none. Tracker thread. No allocation.
class ShakeFit {
 public:
  /// What is known of the camera's own turns by now.
  void fill(const MeasuredShake& measured, ReadoutMotion* motion) const;
  /// By how much `motion`, as it was filled then, is off what is known of it by now: root mean square over the rows
  /// [rad]; 0 where neither shakes.
  double off(const MeasuredShake& measured, const ReadoutMotion& motion) const;

  /// From a picture whose pose minimises the measurements' residuals, as FrameNoise::covariance() has it; what the pose
  /// takes for its own is no evidence. They were freed of the motion that fill() gave. correlated: how many times less
  /// sure they are together than if they were independent (FrameNoise::correlated()).
  void learn(const CameraModel& camera, std::span<const PoseMeasurement> measurements, const SE3& T_cam_world,
             double weight_scale, double correlated, const MeasuredShake& measured, const ReadoutMotion& motion);
  /// Without a map, from three pictures in a row, the newest first: where tracks are off going evenly, beyond one turn
  /// of the whole picture.
  void learn(std::span<const InitialTracks::InThreeViews> tracks, const std::array<MeasuredShake, 3>& measured);

  double gain() const { return found_(0); }
  double rate_s() const { return found_(1); }  ///< that a turn rate counts by: how late the sensor is, times the gain

 private:
  /// Takes in a picture's normal equations of nuisances and both figures, in this order, the nuisances eliminated.
  template <int kNuisances>
  void take(const Eigen::Matrix<double, kNuisances + 2, kNuisances + 2>& H,
            const Eigen::Matrix<double, kNuisances + 2, 1>& b, const Vec2& about, double sure);

  Eigen::Matrix2d information_ = Eigen::Matrix2d::Zero();
  Vec2 weighted_ = Vec2::Zero();
  Vec2 found_ = Vec2::UnitX();  ///< gain, and what the rate counts by [s]
};

}  // namespace godwit::vo
