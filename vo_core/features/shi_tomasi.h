// How well a corner can be tracked (Shi and Tomasi, "Good Features to Track", CVPR 1994).
#pragma once

#include "hal/rt/image.h"

namespace godwit::vo {

/// Smallest distance of a pixel from the edge at which shi_tomasi can be computed.
constexpr int kShiTomasiBorder = 5;

/// Smaller eigenvalue of the mean structure tensor over the 8x8 pixels [x - 4, x + 4) x [y - 4, y + 4), in squared grey
/// levels a pixel; gradients are central differences (I(x + 1) - I(x - 1)) / 2. The sums are exact integers: the same
/// on every machine. Zero nearer to the edge than kShiTomasiBorder. SIMD, no allocation, any thread.
float shi_tomasi(const rt::ImageView& image, int x, int y);

}  // namespace godwit::vo
