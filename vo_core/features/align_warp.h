// The geometry of sparse alignment: where a point of the reference frame appears in the current one, and how the motion
// moves it, with a rolling shutter that reads both frames while the motion goes on.
#pragma once

#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

/// A point in the current camera's frame at the time its row is read, `row_time` later than the capture time, over the
/// time between the frames. p_cur: where it is at the capture time, T_cur_ref * p_ref; motion: T_cur_ref.log().
inline Vec3 align_warp(const Vec3& p_cur, const Vec6& motion, double row_time) {
  return p_cur + row_time * (motion.head<3>() + motion.tail<3>().cross(p_cur));
}

/// Derivative of the pixel by a small motion x between the frames, T_cur_ref = exp(x), at x = 0: by the time its row is
/// read, more of the motion has come to pass than at the capture time, or less. Jp: d pixel / d p at p_ref.
inline Mat26 align_jacobian(const Mat23& Jp, const Vec3& p_ref, double row_time) {
  Mat26 J;
  J.leftCols<3>() = Jp;
  J.rightCols<3>() = -Jp * skew(p_ref);
  return (1.0 + row_time) * J;
}

}  // namespace godwit::vo
