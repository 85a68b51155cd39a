// Between the tracker's words and a record's: what it said of a frame as those take it who make it metric, and a pose
// of the navigation frame as the record holds it.
#pragma once

#include <array>

#include "firmware_app/pipeline/frame_record.h"
#include "hal/aid/aid.h"
#include "vo_core/inertial/inertial_odometry.h"
#include "vo_core/inertial/navigation_frame.h"
#include "vo_core/tracking/tracker.h"

namespace godwit::app {

/// Row by row: camera points into the body.
vo::CameraMounting mounting_of(const std::array<double, 16>& T_body_cam);

/// t_ns: of the picture, in the clock of whoever takes it, whose age of the reference keyframe is that of
/// t_capture_ns. Not tracked where one of the numbers is none. Points into the result.
vo::VisualPose visual_pose(const vo::FrameResult& result, rt::TimeNs t_capture_ns, rt::TimeNs t_ns);

/// Pose, covariances and what was corrected; the record is metric then.
void fill_metric(const vo::NavigationPose& pose, FrameRecord* record);

/// What an aid that knows lengths says, shift_ns later on the clock of whoever takes it.
vo::AidReading reading_of(const hal::AidSample& sample, rt::TimeNs shift_ns = 0);
/// A configured height above flat ground where the first map begins.
vo::AidReading start_reading(double height_m);
/// Scale as lengths from others have it.
void tell_shares(const vo::ScaleState& scale, InertialRecord* record);

/// A frame that vision has a pose of and nobody metres: it counts as not tracked, and says why, with figures in the
/// unit that why names.
void tell_unmetric(const char* why, double value, double limit, FrameRecord* record);

}  // namespace godwit::app
