// Fundamental matrix between two views: estimation, and the motions that an essential matrix stands for.
#pragma once

#include <array>
#include <span>

#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

/// F with b^T F a = 0 for the chosen points (8 or more), rank 2, by the normalised eight-point algorithm (Hartley,
/// TPAMI 1997). False if they are degenerate. No allocation.
bool fundamental_from_points(std::span<const Vec2> a, std::span<const Vec2> b, std::span<const int> index, Mat3* F);

/// The four motions T_b_a, |t| = 1, of an essential matrix (Hartley and Zisserman, section 9.6.2). No allocation.
std::array<SE3, 4> decompose_essential(const Mat3& E);

}  // namespace godwit::vo
