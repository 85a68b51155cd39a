// Homography between two views of a plane: estimation and decomposition into motion and plane.
#pragma once

#include <array>
#include <span>

#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

/// H with b ~ H a for the chosen points (4 or more), by the normalised direct linear transform (Hartley and Zisserman,
/// Multiple View Geometry, algorithm 4.2). False if they are degenerate. No allocation.
bool homography_from_points(std::span<const Vec2> a, std::span<const Vec2> b, std::span<const int> index, Mat3* H);

/// A motion and the plane n . p = 1 (first camera's frame, n / |n| its normal, 1 / |n| its distance; the translation
/// has that distance as its unit) that a homography stands for: H ~ R + t n^T with |n| = 1.
struct PlaneMotion {
  SE3 T_b_a;
  Vec3 normal;
};

/// The motions that a homography between normalised image planes (K^-1 H K, scaled so that b^T H a > 0) stands for:
/// four, two of each differ in sign (Ma, Soatto, Kosecka, Sastry: An Invitation to 3-D Vision, section 5.3.3). 0 if it
/// is a rotation within `min_translation` (|t| / distance) or singular: no plane to be found. No allocation.
int decompose_homography(const Mat3& H, double min_translation, std::array<PlaneMotion, 4>* motions);

/// The other motion that shows the plane n . p = 1 as T_b_a does, translation in its unit: the second pair of the four
/// above. Where the motion is along the normal both fall together. False if there is none with the plane in front.
bool other_motion_of_plane(const SE3& T_b_a, const Vec3& plane, SE3* other);

}  // namespace godwit::vo
