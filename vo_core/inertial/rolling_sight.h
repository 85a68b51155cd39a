// What a rolling shutter on a camera that shakes makes of vision's poses: a pose is fitted to rows of different times,
// and what the camera does within a readout errs in each picture another way.
#pragma once

#include "vo_core/inertial/inertial_factors.h"
#include "vo_core/inertial/metric_map.h"

namespace godwit::vo {

/// Covariance of rotation vector [rad] and place [map units] along the map's axes, in this order, from that of a left
/// twist (v, w) of T_cam_map along the camera's axes.
Mat6 turn_and_place(const Mat6& twist, const Mat3& R_map_cam);

/// Makes *sight, which is what a global shutter would have seen, that of a rolling one. Its attitude is the mean over
/// the rows (mean_turn: ImuBuffer::mean_turn over the readout, along the body's axes): it is brought to the moment.
/// What the picture alone is off by (own_covariance) becomes the sight's own, and how turns and places go together what
/// the tracker says of both: seen from above, a turn is a way. Where own_covariance is no covariance the sight stays as
/// one without. No allocation.
void see_rolling(const VisualPose& pose, const Mat3& R_body_cam, const Vec3& mean_turn, const InertialModel& model,
                 VisionSight* sight);

}  // namespace godwit::vo
