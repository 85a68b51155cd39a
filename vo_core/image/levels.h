// Between the levels of a pyramid: scale, places, and what still lies inside a picture.
#pragma once

#include "hal/rt/image.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

/// Level-0 pixels to one pixel of pyramid level l.
constexpr float level_scale(int level) {
  return static_cast<float>(1 << level);
}

/// Level-0 pixel -> pixel of pyramid level l, and back (centre convention of rt::PyramidView).
inline Vec2f to_level(const Vec2f& px, int level) {
  const float s = 1.0f / level_scale(level);
  return (px.array() + 0.5f) * s - 0.5f;
}
inline Vec2f from_level(const Vec2f& px, int level) {
  return (px.array() + 0.5f) * level_scale(level) - 0.5f;
}
inline Vec2f from_level(int x, int y, int level) {
  return from_level(Vec2f(static_cast<float>(x), static_cast<float>(y)), level);
}

/// px lies `before` or more behind the left and upper edge and more than `behind` before the right and lower one [px of
/// this picture]. A NaN does not.
inline bool window_inside(const rt::ImageView& image, const Vec2f& px, int before, int behind) {
  const auto from = static_cast<float>(before);
  return px.x() >= from && px.y() >= from && px.x() < static_cast<float>(image.width - behind) &&
         px.y() < static_cast<float>(image.height - behind);
}

}  // namespace godwit::vo
