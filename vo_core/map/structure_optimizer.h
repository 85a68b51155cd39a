// Structure-only optimisation (Forster et al. 2014, section IV-C): the position of one point that fits its
// observations.
#pragma once

#include "vo_core/geometry/camera_model.h"
#include "vo_core/map/map.h"

namespace godwit::vo {

/// Gauss-Newton over all observations of the point, poses fixed, at most max_iterations. Moves p_world in place; leaves
/// it where it was when the system is singular or the error does not fall. Returns the rms reprojection error [px,
/// level- weighted] after it, or a negative number when no observation could be projected. No allocation.
double optimize_structure(const CameraModel& camera, const Map& map, const MapPoint& point, int max_iterations,
                          Vec3* p_world);

}  // namespace godwit::vo
