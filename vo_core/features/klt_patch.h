// The patches that klt_tracker.cpp follows: cut from the reference picture, as a picture that has grown or turned shows
// them, and found again by inverse-compositional Lucas-Kanade. For edges of 8 and 16 px.
#pragma once

#include <array>

#include "hal/rt/image.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::vo::klt {

/// Patch of edge P with what an iteration needs.
template <int P>
struct Template {
  alignas(64) std::array<float, P * P> intensity;  ///< mean removed
  alignas(64) std::array<float, P * P> gx, gy;     ///< orthogonal to the patch and to the constant
  float inv_xx = 0, inv_xy = 0, inv_yy = 0;        ///< inverse of the gradient matrix
  float mean = 1;                                  ///< removed from `intensity`, at least 1
  float norm = 0;                                  ///< length of `intensity`
  float signal = 1;                                ///< share of its variance that is not noise
  Vec2f centre = Vec2f::Zero();  ///< of the gradients' energy, from the patch's centre [px of its level]
  bool valid = false;
};

/// The patch at px as a picture shows it to which `warp` leads from this one. False if it leaves the picture or has no
/// texture.
template <int P>
bool make_template(const rt::ImageView& image, const Vec2f& px, const Eigen::Matrix2f& warp, float noise,
                   float min_eigenvalue, Template<P>* t);

enum class Outcome { kConverged, kNotConverged, kOutside };

/// Moves *px (of the image's level) onto the patch. Where it left the picture, *px is what it was.
template <int P>
Outcome align(const rt::ImageView& image, const Template<P>& t, int max_iterations, float converged_px, Vec2f* px);

/// Normalised cross-correlation of the patch with the picture at px (of the image's level); -1 where there is none.
template <int P>
float correlation(const rt::ImageView& image, const Template<P>& t, const Vec2f& px);

}  // namespace godwit::vo::klt
