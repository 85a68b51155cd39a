#include "detector/silhouette.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

namespace godwit::detector {
namespace {

constexpr int kCells = BoxShape::kCells;

/// Cells from `first` up to `end` along one side of the map.
struct Range {
  int first, end;
};

Range range(float low, float high, int size) {
  const float limit = static_cast<float>(size);
  const int first = std::min(static_cast<int>(std::clamp(low, 0.F, limit)), size - 1);
  const int end = static_cast<int>(std::ceil(std::clamp(high, 0.F, limit)));
  return {first, std::max(end, first + 1)};
}

bool covered(const SilhouetteMap& map, Range x, Range y, float threshold) {
  for (int j = y.first; j < y.end; ++j) {
    const float* const row = map.value.data() + static_cast<std::ptrdiff_t>(j) * map.columns;
    // Also true for NaN.
    if (std::any_of(row + x.first, row + x.end, [threshold](float v) { return !(v < threshold); })) return true;
  }
  return false;
}

/// Covers what has covered cells on all four sides: the network leaves holes in a striped shirt.
void fill_holes(BoxShape* shape) {
  BoxShape above, below;
  std::uint32_t so_far = 0;
  for (std::size_t y = 0; y < kCells; ++y) above.row[y] = so_far |= shape->row[y];
  so_far = 0;
  for (std::size_t y = kCells; y-- > 0;) below.row[y] = so_far |= shape->row[y];
  for (std::size_t y = 0; y < kCells; ++y) {
    std::uint32_t left = shape->row[y], right = left;
    for (int step = 1; step < kCells; step *= 2) {
      left |= left << step;
      right |= right >> step;
    }
    shape->row[y] |= left & right & above.row[y] & below.row[y];
  }
}

}  // namespace

void shape_boxes(const SilhouetteMap& map, const ModelInfo& info, const LetterboxFit& fit,
                 const SilhouetteOptions& options, std::span<Box> boxes) {
  if (map.columns < 1 || map.rows < 1 ||
      map.value.size() != static_cast<std::size_t>(map.columns) * static_cast<std::size_t>(map.rows))
    return;
  const float to_x = static_cast<float>(map.columns) / static_cast<float>(info.input_width);
  const float to_y = static_cast<float>(map.rows) / static_cast<float>(info.input_height);
  const auto map_x = [&](float x) { return (x * fit.scale + static_cast<float>(fit.left)) * to_x; };
  const auto map_y = [&](float y) { return (y * fit.scale + static_cast<float>(fit.top)) * to_y; };
  for (Box& box : boxes) {
    const auto id = static_cast<std::size_t>(box.class_id);
    if (box.class_id < 0 || id >= info.silhouette.size() || !info.silhouette[id]) continue;
    BoxShape shape;
    shape.row.fill(0);
    int all = 0;
    const float w = box.width() / kCells, h = box.height() / kCells;
    for (int y = 0; y < kCells; ++y) {
      const float top = box.y0 + h * static_cast<float>(y);
      const Range rows = range(map_y(top), map_y(top + h), map.rows);
      for (int x = 0; x < kCells; ++x) {
        const float left = box.x0 + w * static_cast<float>(x);
        if (!covered(map, range(map_x(left), map_x(left + w), map.columns), rows, options.threshold)) continue;
        shape.row[static_cast<std::size_t>(y)] |= std::uint32_t{1} << x;
        ++all;
      }
    }
    if (static_cast<float>(all) < options.least_share * kCells * kCells) continue;
    fill_holes(&shape);
    box.shape = shape;
  }
}

BoxShape shape_over(const Box& box, const Box& other, float reach_x, float reach_y, Outside outside) {
  BoxShape out;
  if (box.shape.whole() && outside == Outside::kCovered) return out;
  // Cells of `box` that each column and row of `other` meets, and whether it meets what lies outside.
  constexpr float kTouch = 1e-3F;  // rounding makes no neighbour
  const auto meets = [](float low, float high, float begin, float side, float reach, Range* cells) {
    const float first = (low - reach - begin) / side * kCells + kTouch;
    const float end = (high + reach - begin) / side * kCells - kTouch;
    const auto clamped = [](float v) { return v > 0.F ? static_cast<int>(std::min(v, float{kCells})) : 0; };
    *cells = {clamped(first), clamped(std::ceil(end))};
    return !(first >= 0.F && end <= kCells);
  };
  std::array<std::uint32_t, kCells> columns{};
  std::array<bool, kCells> column_outside{};
  const float w = other.width() / kCells, h = other.height() / kCells;
  for (int x = 0; x < kCells; ++x) {
    Range cells{};
    const float left = other.x0 + w * static_cast<float>(x);
    const auto i = static_cast<std::size_t>(x);
    column_outside[i] = meets(left, left + w, box.x0, box.width(), reach_x, &cells);
    for (int c = cells.first; c < cells.end; ++c) columns[i] |= std::uint32_t{1} << c;
  }
  for (int y = 0; y < kCells; ++y) {
    Range cells{};
    const float top = other.y0 + h * static_cast<float>(y);
    const bool row_outside = meets(top, top + h, box.y0, box.height(), reach_y, &cells);
    std::uint32_t seen = 0, row = 0;
    for (int r = cells.first; r < cells.end; ++r) seen |= box.shape.row[static_cast<std::size_t>(r)];
    for (std::size_t x = 0; x < kCells; ++x) {
      const bool beyond = outside == Outside::kCovered && (row_outside || column_outside[x]);
      row |= static_cast<std::uint32_t>(beyond || (seen & columns[x]) != 0) << x;
    }
    out.row[static_cast<std::size_t>(y)] = row;
  }
  return out;
}

}  // namespace godwit::detector
