// Squares of a wide picture that the network looks at beside the whole one: scaled down less, so that small things of
// aerial pictures are large enough to be found. Pure computation.
#pragma once

#include <array>
#include <span>

#include "detector/box.h"

namespace godwit::detector {

constexpr int kMaxTiles = 8;

/// A part of a picture [px].
struct Tile {
  int left = 0, top = 0, width = 0, height = 0;
};

struct TileList {
  std::array<Tile, kMaxTiles> tile{};
  int count = 0;
  std::span<const Tile> view() const& { return std::span(tile).first(count); }
  std::span<const Tile> view() const&& = delete;  // it would outlive its list
};

/// Tiles in a row along the longer side, each as long as the shorter one, of which neighbours share about a quarter:
/// what is shorter than a sixth lies whole in the inner part of one of them. So long a picture that kMaxTiles squares
/// do not suffice gets longer ones. None where the longer side is at most 5/4 of the other: there is little to gain.
/// Preconditions: sizes are positive.
TileList square_tiles(int picture_width, int picture_height);

/// Where a box must lie, in pixels of the tile, so as not to be cut off by an end of the tile inside the picture. What
/// reaches out of it is part of something that a neighbour, or the whole picture, shows better. Without limit towards
/// the picture's own edges.
Box inner_part(const Tile& tile, int picture_width, int picture_height);

/// What several looks at one picture found, as one list: class-wise greedy non-maximum suppression as in
/// Decoder::decode, surest first, ties by order. Reorders the candidates; allocates.
void merge(std::span<Box> candidates, float nms_iou, BoxList* boxes);

}  // namespace godwit::detector
