// How noisy the grey levels of a picture are, from the picture alone: what tells texture from noise.
#pragma once

#include <algorithm>

#include "hal/rt/image.h"

namespace godwit::vo {

/// One sigma of the white noise of a picture [grey levels] (Immerkaer, "Fast noise variance estimation", Computer
/// Vision and Image Understanding 1996): the mean response to a mask that constants, slopes and straight edges along
/// the axes leave at zero, in blocks of 16 x 16; of the blocks the quietest tenth, since texture answers, too. Blocks
/// at the end of the scale have no noise and do not count. At least kLeastGreyNoise. No allocation, any thread; a
/// quarter of the picture is read.
float grey_noise(const rt::ImageView& image);

/// Rounding to whole grey levels alone is 0.29; what compression and denoising leave is not white, and counts as this.
/// Of 14 starts at euroc_mh01's slow beginning (compressed, 0.4 by its pixels) the mean error is 4.9 mm with 1, 4.5
/// with 1.5, 4.9 with 2, 5.1 with 3.
constexpr float kLeastGreyNoise = 1.5f;

/// Of the mean of 4^level pixels, which a pyramid level shows: white noise halves from level to level, rounding anew at
/// each leaves half a grey level or so.
inline float grey_noise_at(float noise, int level) {
  return std::max(noise / static_cast<float>(1 << level), 0.5f);
}

}  // namespace godwit::vo
