// Rows of three bytes a pixel into grey and BGR, several pixels at once.
#pragma once

#include <cstdint>

namespace godwit::hal {

/// Blue, green, red, or with red_first the other way round. Grey is BT.601's: 0.299 red, 0.587 green, 0.114 blue, in
/// 1/256 and rounded. bgr: 3 * width bytes, or null.
void rgb_row(const std::uint8_t* from, int width, bool red_first, std::uint8_t* grey, std::uint8_t* bgr);

}  // namespace godwit::hal
