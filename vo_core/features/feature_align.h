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

struct FeatureAlignResult {
  bool converged = false;
  float residual = 0.0f;  ///< rms difference after gain and offset, divided by the reference's contrast (rms)
  float gain = 1.0f;
};

/// Moves *px (pixels of `image`'s level, start value in, result out) until the patch agrees. Two degrees of freedom.
/// Fails when it leaves the picture, moves more than max_shift_px, does not settle, or the patch has no texture.
FeatureAlignResult align_2d(const rt::ImageView& image, const ReferencePatch& ref, int max_iterations,
                            float max_shift_px, Vec2f* px);

/// The same along one unit direction of the picture only (edgelets).
FeatureAlignResult align_1d(const rt::ImageView& image, const ReferencePatch& ref, const Vec2f& direction,
                            int max_iterations, float max_shift_px, Vec2f* px);

}  // namespace godwit::vo
