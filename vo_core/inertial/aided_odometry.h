// Metres and the vertical for a visual map without an inertial sensor: the vertical by an autopilot's attitude, metres
// by a rangefinder, a barometer, satellites or a height that was configured. Beside the tracker, from its poses.
#pragma once

#include <cstdint>

#include "vo_core/inertial/inertial_factors.h"
#include "vo_core/inertial/map_vertical.h"
#include "vo_core/inertial/metric_map.h"
#include "vo_core/inertial/scale_aids.h"
#include "vo_core/inertial/velocity_fit.h"

namespace godwit::vo {

struct AidedOdometryOptions {
  ScaleAidsOptions aids;
  MapVerticalOptions vertical;
  Vec3 range_beam = Vec3::UnitZ();  ///< of the rangefinder, along the body's axes, unit length
  /// Metric from here on: sigmas of the scale's logarithm and of the vertical. A configured height alone comes to 0.18,
  /// an autopilot's attitude to 0.02 rad. What that is worth the covariance says.
  double begin_scale_sigma = 0.2, begin_up_sigma = 0.06;
  double lost_scale_sigma = 0.3, lost_up_sigma = 0.1;  ///< and not any more from here on
  /// Vision's own, as where an inertial sensor is (InertialModel, InertialOdometryOptions).
  double position_sigma = 1e-3;  ///< [depths]
  double rotation_sigma = 1e-3;  ///< [rad]
  double drift_share = 2e-4;     ///< of the way flown
  double told_place_sigma_m = 4e-3, told_speed_sigma_m_s = 6e-3;
  VisionStrayOptions stray;
};

/// One thread; no allocation after the constructor. Frames and readings in the order of their times, all in one clock.
///
/// What is told stands in one frame as long as the map is metric; whatever interrupts that (another map, a scale or a
/// vertical that is given up) ends the frame, and the next one begins where and as it headed then: nobody knows what
/// happened between.
class AidedOdometry : public MetricMap {
 public:
  explicit AidedOdometry(const CameraMounting& mounting, const AidedOdometryOptions& options = {})
      : MetricMap(options.stray),
        options_(options),
        R_cam_body_(mounting.R_body_cam.transpose()),
        aids_(options.aids),
        vertical_(mounting.R_body_cam, options.vertical) {}

  /// False: no number, out of order, or no room; it is passed over.
  bool take(const AidReading& reading) { return aids_.take(reading); }
  bool take(const AttitudeReading& reading) { return vertical_.take(reading); }
  /// Takes in one frame and says what it is in metres. Bounded.
  MetricPose frame(const VisualPose& pose);

  /// An attitude was heard, ever: before that nobody has promised metres.
  bool attitude_heard() const { return vertical_.heard(); }
  const ScaleState& scale() const { return aids_.state(); }
  const MapVertical& vertical() const { return vertical_; }

 private:
  void correct_map(const VisualPose& pose);
  void hear(const VisualPose& pose);
  bool good_enough();
  MetricPose tell(const VisualPose& pose);
  void tell_velocity(const VisualPose& pose, const Mat3& shared, MetricPose* out);

  const AidedOdometryOptions options_;
  const Mat3 R_cam_body_;
  ScaleAids aids_;
  MapVertical vertical_;
  VelocityFit fit_;
  std::uint32_t map_id_ = 0;
  Vec3 last_camera_ = Vec3::Zero();
  rt::TimeNs t_last_ns_ = 0;  ///< of the last picture with a pose
  double way_ = 0;            ///< flown since the anchor [map units]
};

}  // namespace godwit::vo
