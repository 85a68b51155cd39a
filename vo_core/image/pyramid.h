// Grey image pyramid by half-sampling.
#pragma once

#include <cstddef>

#include "hal/rt/image.h"

namespace godwit::vo {

/// dst(x, y) = (a + b + c + d + 2) >> 2 over the 2x2 block at (2x, 2y) of src; dst has floor(size / 2) of src.
/// SIMD; may read, not use, up to rt::kRowAlignment bytes behind a row of src. No allocation.
void half_sample(const rt::ImageView& src, const rt::MutableImageView& dst);

/// Bytes that build_pyramid needs for levels 1..levels-1 of a width x height picture, rows aligned to
/// rt::kRowAlignment.
std::size_t pyramid_bytes(int width, int height, int levels);

/// Builds levels 1..levels-1 into storage (aligned to rt::kRowAlignment, at least pyramid_bytes long) and returns the
/// views; level 0 is base itself. levels <= rt::kPyramidLevels. No allocation.
rt::PyramidView build_pyramid(const rt::ImageView& base, int levels, std::uint8_t* storage, std::size_t storage_bytes);

}  // namespace godwit::vo
