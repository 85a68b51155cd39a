// The tracker's poses made metric and level by the inertial sensor, as the pipeline's records have them.
#pragma once

#include <array>
#include <memory>

#include "firmware_app/pipeline/frame_record.h"
#include "hal/imu/imu.h"
#include "vo_core/inertial_odometry.h"
#include "vo_core/tracker.h"

namespace godwit::app {

/// Tracker thread. No allocation after the constructor.
class InertialPoses {
 public:
  /// Row by row: camera points into the body, whose axes the sensor's readings have.
  explicit InertialPoses(const std::array<double, 16>& T_body_cam);

  void take(const hal::ImuSample& sample);
  /// The camera's turn since the last frame by the gyroscope, as a prior of its alignment; none while the gyroscope's
  /// bias is not known. Before the frame at t_ns is tracked.
  vo::RotationPrior turn_since_last(rt::TimeNs t_ns) const;
  /// After it: the record's pose becomes that of the navigation frame. While scale and vertical are not known the frame
  /// does not count as tracked, and the record says what is waited for.
  void make_metric(const vo::FrameResult& result, rt::TimeNs t_ns, FrameRecord* record);

 private:
  std::unique_ptr<vo::InertialOdometry> odometry_;
  rt::TimeNs t_last_ns_ = 0;
};

}  // namespace godwit::app
