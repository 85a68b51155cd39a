#include "detector/tiles.h"

#include <algorithm>

#include "detector/decode.h"

namespace godwit::detector {
namespace {
/// Of a tile's length: what neighbours share, and how near to its end a box may be one that is cut off: the network is
/// not sure of such an edge to a dozen pixels of its input.
constexpr int kSharedPart = 4, kEndPart = 33;
}  // namespace

TileList square_tiles(int picture_width, int picture_height) {
  TileList out;
  const bool wide = picture_width >= picture_height;
  const int longer = std::max(picture_width, picture_height), shorter = std::min(picture_width, picture_height);
  // n tiles of length s reach over s + (n - 1) x 3 s / 4.
  constexpr int kReach = kSharedPart + (kMaxTiles - 1) * (kSharedPart - 1);
  const int side = std::max(shorter, (kSharedPart * longer + kReach - 1) / kReach);
  if (side >= longer || 4 * longer <= 5 * shorter) return out;
  const int step = std::max(1, side - (side + kSharedPart - 1) / kSharedPart);
  out.count = std::min(kMaxTiles, 1 + (longer - side + step - 1) / step);
  for (int i = 0; i < out.count; ++i) {
    const int at = i * (longer - side) / (out.count - 1);
    out.tile[i] = wide ? Tile{at, 0, side, shorter} : Tile{0, at, shorter, side};
  }
  return out;
}

Box inner_part(const Tile& tile, int picture_width, int picture_height) {
  const auto w = static_cast<float>(tile.width), h = static_cast<float>(tile.height);
  const float end = std::max(w, h) / kEndPart;
  Box out = Decoder::kAnywhere;
  if (tile.left > 0) out.x0 = end;
  if (tile.top > 0) out.y0 = end;
  if (tile.left + tile.width < picture_width) out.x1 = w - end;
  if (tile.top + tile.height < picture_height) out.y1 = h - end;
  return out;
}

void merge(std::span<Box> candidates, float nms_iou, BoxList* boxes) {
  boxes->clear();
  std::stable_sort(candidates.begin(), candidates.end(), [](const Box& a, const Box& b) { return a.score > b.score; });
  for (const Box& box : candidates)
    if (!suppressed(box, *boxes, nms_iou) && !boxes->push(box)) return;
}

}  // namespace godwit::detector
