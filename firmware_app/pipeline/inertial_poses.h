// The tracker's poses made metric and level by the inertial sensor and hung into one navigation frame, as the
// pipeline's records have them.
#pragma once

#include <array>
#include <memory>

#include "firmware_app/pipeline/frame_record.h"
#include "hal/aid/aid.h"
#include "hal/imu/error_model.h"
#include "hal/imu/imu.h"
#include "vo_core/inertial/even_pace.h"
#include "vo_core/inertial/inertial_odometry.h"
#include "vo_core/inertial/navigation_frame.h"
#include "vo_core/tracking/tracker.h"

namespace godwit::app {

/// Tracker thread. No allocation after the constructor.
class InertialPoses {
 public:
  /// Row by row: camera points into the body, whose axes the sensor's readings have.
  /// coast_ns: how long a pose may come from that sensor alone. time_offset_s: what to add to the camera's times to
  /// have that sensor's, as calibrated. errors: the sensor's, as far as they are known. readout_ns: of the camera's
  /// rolling shutter, 0: global.
  InertialPoses(const std::array<double, 16>& T_body_cam, rt::TimeNs coast_ns, double time_offset_s = 0,
                const hal::ImuErrorModel& errors = {}, rt::TimeNs readout_ns = 0);

  void take(const hal::ImuSample& sample);
  void take(const hal::AidSample& sample);
  /// The camera's height above flat ground where the first map begins. Before the first frame.
  void starts_at_height(double height_m);
  /// The camera's turn since the last frame by the gyroscope, as a prior of its alignment; none while the gyroscope's
  /// bias is not known. Before the frame at t_ns is tracked.
  vo::RotationPrior turn_since_last(rt::TimeNs t_ns) const;
  /// How it turned while that frame's rows were read: nothing with a global shutter.
  vo::MeasuredShake shake(rt::TimeNs t_ns) const;
  /// Where that frame's camera should be in the map, where the last one saw nothing.
  vo::PosePrior expected(rt::TimeNs t_ns) const;
  /// After it: the record's pose becomes that of the navigation frame. Where the picture gives none, or none with scale
  /// and vertical, the frame does not count as tracked: the pose is the inertial sensor's for a while, and then the
  /// record says what is waited for. Nothing of what vision knows is rescaled or turned.
  void make_metric(const vo::FrameResult& result, rt::TimeNs t_ns, FrameRecord* record);

 private:
  void tell_sensor(double log_scale_sigma);
  void fill(const vo::NavigationPose& pose, FrameRecord* record) const;

  std::unique_ptr<vo::InertialOdometry> odometry_;
  std::unique_ptr<vo::NavigationFrame> navigation_;
  vo::EvenPace pace_;
  const rt::TimeNs coast_ns_;
  const rt::TimeNs shift_ns_;  ///< what is calibrated; all times within are the inertial sensor's
  InertialRecord sensor_;      ///< as known with the last picture that gave a metric pose
  rt::TimeNs t_last_ns_ = 0;
  bool last_seen_ = false;  ///< that picture gave a pose in the map
};

}  // namespace godwit::app
