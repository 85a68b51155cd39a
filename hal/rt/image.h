// Views of 8-bit grey pictures and of a pyramid of them. A view owns nothing.
#pragma once

#include <array>
#include <cstdint>

namespace godwit::rt {

/// Levels of the grey pyramid; level l has floor(width / 2^l) x floor(height / 2^l) pixels.
constexpr int kPyramidLevels = 5;
/// Every row of every level starts on this boundary, and at least this many readable bytes follow the last pixel.
constexpr int kRowAlignment = 64;
/// Largest picture a frame slot holds.
constexpr int kMaxImageWidth = 1280;
constexpr int kMaxImageHeight = 1024;

/// Read-only 8-bit grey picture. Pixel (x, y), x right, y down, is data[y * stride + x].
struct ImageView {
  const std::uint8_t* data = nullptr;
  int width = 0;
  int height = 0;
  int stride = 0;

  const std::uint8_t* row(int y) const { return data + static_cast<std::ptrdiff_t>(y) * stride; }
  std::uint8_t at(int x, int y) const { return row(y)[x]; }
  bool empty() const { return data == nullptr; }
};

/// The same, writable.
struct MutableImageView {
  std::uint8_t* data = nullptr;
  int width = 0;
  int height = 0;
  int stride = 0;

  std::uint8_t* row(int y) const { return data + static_cast<std::ptrdiff_t>(y) * stride; }
  operator ImageView() const { return {data, width, height, stride}; }  // NOLINT: implicit by design
};

/// Grey pyramid, level 0 the full picture. Pixel centres: a point at (x, y) in level 0 lies at
/// ((x + 0.5) / 2^l - 0.5, (y + 0.5) / 2^l - 0.5) in level l, because half-sampling averages 2x2 blocks.
struct PyramidView {
  std::array<ImageView, kPyramidLevels> level;
  int levels = 0;
};

/// A mask of dynamic pixels at every pyramid level (the paper, 2.3.1): non-zero = may move, do not use. Same sizes as
/// the pyramid's levels; levels == 0 means that nothing is masked. A type of its own: a mask is no picture to align.
struct MaskPyramidView {
  std::array<ImageView, kPyramidLevels> level;
  int levels = 0;
};

}  // namespace godwit::rt
