// How much of the tracks' motion does a pure rotation explain? What it leaves over is the parallax that a map is made
// of.
#pragma once

#include <span>

#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

/// How far a, turned by R, lies from b on the plane z = 1 [px of focal_px], and its derivative by a rotation vector w
/// from the left, exp(w) R. False, and nothing set, if a ends up beside or behind the camera.
bool rotation_residual(const Mat3& R, const Vec2& a, const Vec2& b, double focal_px, Vec2* r, Mat23* J);

/// Robust rotation R with b ~ R a (points of the planes z = 1), starting from *R; Gauss-Newton with Cauchy weights, a
/// fixed number of steps. Returns the median distance of b from the rotated a [px of focal_px]: 0 without translation
/// and noise. scratch: at least as long as a. No allocation.
double fit_rotation(std::span<const Vec2> a, std::span<const Vec2> b, double focal_px, std::span<double> scratch,
                    Mat3* R);

}  // namespace godwit::vo
