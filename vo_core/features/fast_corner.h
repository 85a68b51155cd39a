// FAST-9 corners (Rosten and Drummond, ECCV 2006) by their exact score, so that one pass serves every threshold.
#pragma once

#include <cstdint>

#include "hal/rt/image.h"

namespace godwit::vo {

/// Radius of the circle of 16 pixels.
constexpr int kFastRadius = 3;

/// The FAST-9 score of a pixel: the largest s such that nine neighbouring pixels of the circle are all brighter than
/// the centre by at least s, or all darker. The pixel is a corner at threshold t if and only if s > t. Plain code, the
/// reference for fast_score_row. Precondition: kFastRadius pixels from the edge.
int fast_score(const rt::ImageView& image, int x, int y);

/// Scores of the pixels [x_begin, x_end) of row y into scores[x_begin, x_end); scores up to `threshold` become 0.
/// Precondition: all pixels at least kFastRadius from the edge. SIMD; touches nothing outside those ranges (and their
/// circles). No allocation, any thread.
void fast_score_row(const rt::ImageView& image, int y, int x_begin, int x_end, int threshold, std::uint8_t* scores);

/// 3x3 non-maximum suppression: writes the x in [x_begin, x_end) at which `row` holds a maximum of its 3x3 block to xs
/// (room for (x_end - x_begin + 1) / 2) and returns how many. Of equal neighbours the first in reading order wins.
/// The rows must be readable, and hold scores or zeros, from x_begin - 1 to x_end. SIMD, no allocation.
int fast_maxima_row(const std::uint8_t* above, const std::uint8_t* row, const std::uint8_t* below, int x_begin,
                    int x_end, std::int16_t* xs);

}  // namespace godwit::vo
