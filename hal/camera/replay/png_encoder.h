// Grey pictures as PNG, in memory, with libpng: quickly rather than small.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "hal/rt/image.h"

namespace godwit::hal {

/// Without loss; decode_picture() gives the same pixels. Memory of *out is used again. Some 5 ms for 752 x 480. Returns
/// what went wrong in words; empty: nothing. Allocates.
std::string encode_png(const rt::ImageView& grey, std::vector<std::uint8_t>* out);

}  // namespace godwit::hal
