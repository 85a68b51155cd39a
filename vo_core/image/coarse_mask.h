// The dynamic pixels of a frame in small: what the mapper must know of them, in a size that travels with a message.
#pragma once

#include <array>
#include <cstdint>
#include <cstring>

#include "hal/rt/image.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

/// Masked share of the picture above which it counts as crowded: features are scarce then, and tracker and mapper are
/// content with less where it agrees.
constexpr double kCrowdedShare = 0.3;

/// Share of the pixels that are not 0; 0 of no picture.
inline double masked_share(const rt::ImageView& mask) {
  int n = 0;
  for (int y = 0; y < mask.height; ++y)
    for (int x = 0; x < mask.width; ++x) n += mask.row(y)[x] != 0;
  return mask.width * mask.height > 0 ? static_cast<double>(n) / (mask.width * mask.height) : 0.0;
}

/// Cells of 8 x 8 pixels of level 0: level 3 of a mask pyramid. No columns: nothing is masked.
struct CoarseMask {
  static constexpr int kLevel = 3;
  static constexpr int kMaxColumns = rt::kMaxImageWidth >> kLevel, kMaxRows = rt::kMaxImageHeight >> kLevel;
  int columns = 0, rows = 0;
  std::array<std::uint8_t, kMaxColumns * kMaxRows> cell;  ///< rows of `columns`; not 0: masked

  void assign(const rt::MaskPyramidView& mask) {
    columns = rows = 0;
    if (mask.levels <= kLevel) return;
    const rt::ImageView& level = mask.level[kLevel];
    columns = level.width;
    rows = level.height;
    for (int y = 0; y < rows; ++y)
      std::memcpy(cell.data() + static_cast<std::ptrdiff_t>(y) * columns, level.row(y), columns);
  }
  /// Copies only what is used.
  void assign(const CoarseMask& other) {
    columns = other.columns;
    rows = other.rows;
    std::memcpy(cell.data(), other.cell.data(), columns * rows);
  }
  /// Masks what the other masks, too. Of the same size, or this one or the other empty.
  void add(const CoarseMask& other) {
    if (empty()) {
      assign(other);
      return;
    }
    if (other.empty()) return;
    for (int i = 0; i < columns * rows; ++i) cell[i] |= other.cell[i];
  }
  void add(const rt::MaskPyramidView& mask) {
    CoarseMask other;
    other.assign(mask);
    add(other);
  }
  void clear() { columns = rows = 0; }
  bool empty() const { return columns == 0; }
  /// Share of the picture that is masked, 0 to 1.
  double covered() const { return masked_share({cell.data(), columns, rows, columns}); }
  /// Share of the picture that is masked here and free in `later`, the mask of another frame of the same size.
  double uncovered(const rt::MaskPyramidView& later) const {
    if (empty() || later.levels <= kLevel) return 0.0;
    int n = 0;
    for (int y = 0; y < rows; ++y) {
      const std::uint8_t* before = cell.data() + static_cast<std::ptrdiff_t>(y) * columns;
      const std::uint8_t* now = later.level[kLevel].row(y);
      for (int x = 0; x < columns; ++x) n += before[x] != 0 && now[x] == 0;
    }
    return static_cast<double>(n) / (columns * rows);
  }
  /// Level-0 pixel inside the picture.
  bool masked(const Vec2f& px) const {
    if (empty()) return false;
    const int x = static_cast<int>(px.x()) >> kLevel, y = static_cast<int>(px.y()) >> kLevel;
    return x < columns && y < rows && cell[y * columns + x] != 0;
  }
};

/// Share of a picture that is masked, 0 to 1: what CoarseMask::covered() tells of it.
inline double covered_share(const rt::MaskPyramidView& mask) {
  return mask.levels > CoarseMask::kLevel ? masked_share(mask.level[CoarseMask::kLevel]) : 0.0;
}

}  // namespace godwit::vo
