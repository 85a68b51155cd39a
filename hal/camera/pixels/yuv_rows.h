// Rows of YUV 4:2:2 and 4:2:0 into grey and BGR, several pixels at once.
#pragma once

#include <cstdint>

namespace godwit::hal {

/// BT.601, limited range, in 1/256: y is the luma, u and v the chroma; blue, green, red into to.
void bgr_of_yuv(int y, int u, int v, std::uint8_t* to);

/// Y0 U Y1 V of two pixels each. bgr: 3 * width bytes, or null. width is even.
void yuyv_row(const std::uint8_t* from, int width, std::uint8_t* grey, std::uint8_t* bgr);

/// A row's luma and the chroma U V that it shares with the next, of two pixels each, into 3 * width bytes. width is
/// even.
void nv12_row(const std::uint8_t* luma, const std::uint8_t* chroma, int width, std::uint8_t* bgr);

/// As bgr_of_yuv, full range (JFIF).
void bgr_of_jpeg(int y, int cb, int cr, std::uint8_t* to);

/// A row of luma and its chroma in planes of their own, one of each for two pixels, full range (JFIF), into 3 * width
/// bytes.
void jpeg_row(const std::uint8_t* luma, const std::uint8_t* cb, const std::uint8_t* cr, int width, std::uint8_t* bgr);

}  // namespace godwit::hal
