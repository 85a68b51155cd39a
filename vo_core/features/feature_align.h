// Sub-pixel feature alignment (Forster et al. 2014, section IV-B): where in the picture a reference patch lies, inverse
// compositional, with gain and offset of the brightness estimated along (each patch its own, so that exposure jumps and
// flicker do not matter).
#pragma once

#include <array>

#include "hal/rt/image.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

constexpr int kPatchSize = 8;
constexpr int kPatchHalf = kPatchSize / 2;
constexpr int kPatchBorderSize = kPatchSize + 2;

/// Reference patch with a border of one pixel, row major. The patch covers pixels -4..+3 around its point.
struct ReferencePatch {
  alignas(32) std::array<float, kPatchBorderSize * kPatchBorderSize> value;
};

/// What alignment makes of a reference patch before it looks at a picture.
struct AlignTemplate {
  alignas(32) std::array<float, kPatchSize * kPatchSize> value;  ///< less their mean
  /// Gradients: by x and y, or by the one direction; then unused.
  alignas(32) std::array<float, kPatchSize * kPatchSize> g0, g1;
  std::array<float, 16> H_inv;  ///< inverse Hessian, of as many rows as there are parameters
  float mean, contrast;         ///< grey levels; contrast: rms
  Vec2f direction;              ///< of one degree of freedom: the unit direction; else zero
};

struct FeatureAlignResult {
  bool converged = false;
  float residual = 0.0f;  ///< rms difference after gain and offset, divided by the reference's contrast (rms)
  float gain = 1.0f;
};

/// For two degrees of freedom, and for one along a unit direction of the picture (edgelets). False: the patch has no
/// texture.
bool prepare_align_2d(const ReferencePatch& ref, AlignTemplate* prepared);
bool prepare_align_1d(const ReferencePatch& ref, const Vec2f& direction, AlignTemplate* prepared);

/// Moves *px (pixels of `image`'s level, start value in, result out) until the patch agrees.
/// Fails when it leaves the picture, moves more than max_shift_px or does not settle.
FeatureAlignResult align(const rt::ImageView& image, const AlignTemplate& prepared, int max_iterations,
                         float max_shift_px, Vec2f* px);

}  // namespace godwit::vo
