#include "detector/tiles.h"

#include <algorithm>

#include "detector/decode.h"

namespace godwit::detector {
namespace {
/// Of a tile's length: what neighbours share at least, and how near to its end a box counts as cut off.
constexpr int kSharedPart = 4, kEndPart = 100;
}  // namespace

TileList square_tiles(int picture_width, int picture_height) {
  TileList out;
  const bool wide = picture_width >= picture_height;
  const int longer = std::max(picture_width, picture_height), shorter = std::min(picture_width, picture_height);
  // n tiles of length s reach over s + (n - 1) x 3 s / 4.
  constexpr int kReach = kSharedPart + (kMaxTiles - 1) * (kSharedPart - 1);
  const int side = std::max(shorter, (kSharedPart * longer + kReach - 1) / kReach);
  if (side >= longer) return out;
  const int step = std::max(1, side - (side + kSharedPart - 1) / kSharedPart);
  out.count = std::min(kMaxTiles, 1 + (longer - side + step - 1) / step);
  for (int i = 0; i < out.count; ++i) {
    const int at = i * (longer - side) / (out.count - 1);
    out.tile[static_cast<std::size_t>(i)] = wide ? Tile{at, 0, side, shorter} : Tile{0, at, shorter, side};
  }
  return out;
}

bool cut_off(const Box& box, const Tile& tile, int picture_width, int picture_height) {
  const auto near = static_cast<float>(std::max(tile.width, tile.height)) / kEndPart;
  const int right = tile.left + tile.width, bottom = tile.top + tile.height;
  return (tile.left > 0 && box.x0 < static_cast<float>(tile.left) + near) ||
         (tile.top > 0 && box.y0 < static_cast<float>(tile.top) + near) ||
         (right < picture_width && box.x1 > static_cast<float>(right) - near) ||
         (bottom < picture_height && box.y1 > static_cast<float>(bottom) - near);
}

void merge(std::span<Box> candidates, float nms_iou, BoxList* boxes) {
  boxes->clear();
  std::stable_sort(candidates.begin(), candidates.end(), [](const Box& a, const Box& b) { return a.score > b.score; });
  for (const Box& box : candidates)
    if (!suppressed(box, *boxes, nms_iou) && !boxes->push(box)) return;
}

}  // namespace godwit::detector
