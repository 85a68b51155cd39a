// How much of the tracks' motion does a pure rotation explain? What it leaves over is the parallax that a map is made
// of.
#pragma once

#include <span>

#include "vo_core/geometry.h"

namespace godwit::vo {

/// Robust rotation R with b ~ R a (points of the planes z = 1), starting from *R; Gauss-Newton with Cauchy weights, a
/// fixed number of steps. Returns the median distance of b from the rotated a [px of focal_px]: 0 without translation
/// and noise. scratch: at least as long as a. No allocation.
double fit_rotation(std::span<const Vec2> a, std::span<const Vec2> b, double focal_px, std::span<double> scratch,
                    Mat3* R);

}  // namespace godwit::vo
