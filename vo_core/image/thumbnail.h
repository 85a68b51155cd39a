// Tiny pictures of frames, to tell which keyframe saw the same place (Klein and Murray 2008, section 3: relocalisation
// by small blurry images).
#pragma once

#include <array>
#include <cstdint>

#include "hal/rt/image.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

/// Mean grey of kWidth x kHeight cells that cover the picture, centred on the picture's mean. A cell is about 32 pixels
/// of a 640x480 picture, so blur is built in.
struct Thumbnail {
  static constexpr int kWidth = 20, kHeight = 15, kCells = kWidth * kHeight;
  std::array<std::int16_t, kCells> value{};  ///< grey minus mean; 0 where not valid
  std::array<std::int16_t, kCells> valid{};  ///< 1 or 0: turned pictures have empty corners, movers are left out
};

/// From the coarsest level of the pyramid, turned about the picture's centre by roll_rad: cell x of the result shows
/// what lies at Rot(roll) x in the picture. Cells with dynamic pixels are not valid. No allocation.
Thumbnail make_thumbnail(const rt::PyramidView& pyramid, const rt::MaskPyramidView& mask, double roll_rad);

/// A picture in which nothing could be found: on the pyramid's level 2 its pixels differ by less than a grey level,
/// root mean square. A covered lens, darkness: there the noise is that of 16 pixels' mean. Not of cells: gravel is as
/// flat as darkness in a thumbnail.
bool shows_nothing(const rt::PyramidView& pyramid);

struct ThumbnailMatch {
  float correlation = -1.0f;  ///< zero-mean, -1 to 1, over the cells that both have
  int dx = 0, dy = 0;         ///< cell (x, y) of `ref` looks like cell (x + dx, y + dy) of `cur`
};

/// Best shift of at most kMaxShiftX x kMaxShiftY cells, every second one. Bounded, no allocation.
constexpr int kMaxShiftX = 8, kMaxShiftY = 6;
ThumbnailMatch match_thumbnails(const Thumbnail& ref, const Thumbnail& cur);

}  // namespace godwit::vo
