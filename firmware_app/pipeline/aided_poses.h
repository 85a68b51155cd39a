// The tracker's poses made metric and level without an inertial sensor, by the autopilot's attitude and by what knows
// lengths, as the pipeline's records have them.
#pragma once

#include <array>
#include <memory>

#include "firmware_app/pipeline/frame_record.h"
#include "hal/aid/aid.h"
#include "vo_core/inertial/aided_odometry.h"
#include "vo_core/tracking/tracker.h"

namespace godwit::app {

/// Tracker thread. No allocation after the constructor.
class AidedPoses {
 public:
  /// Row by row: camera points into the autopilot's body (front, right, down).
  explicit AidedPoses(const std::array<double, 16>& T_body_cam);

  void take(const hal::AidSample& sample);
  /// The camera's height above flat ground where the first map begins. Before the first frame.
  void starts_at_height(double height_m);
  /// After the frame was tracked. As long as no attitude was ever heard the record stays vision's; from then on its
  /// pose is that of the frame in metres, or it does not count as tracked and says what is waited for.
  void make_metric(const vo::FrameResult& result, rt::TimeNs t_ns, FrameRecord* record);

 private:
  std::unique_ptr<vo::AidedOdometry> odometry_;
};

}  // namespace godwit::app
