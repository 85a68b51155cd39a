#include "detector/box_mask.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstring>

namespace godwit::detector {

BoxMask::BoxMask(int width, int height, int levels, const MaskMargin& margin) : margin_(margin) {
  assert(width > 0 && height > 0 && width <= rt::kMaxImageWidth && height <= rt::kMaxImageHeight);
  assert(levels >= 1 && levels <= rt::kPyramidLevels);
  const auto row_bytes = [](int w) { return (w + rt::kRowAlignment - 1) / rt::kRowAlignment * rt::kRowAlignment; };
  // One row alignment before for the start, one after for readers that take whole vectors.
  std::size_t bytes = 2 * rt::kRowAlignment;
  for (int l = 0; l < levels; ++l) {
    bytes += row_bytes(width >> l) * (height >> l);
  }
  storage_.assign(bytes, 0);
  const auto address = reinterpret_cast<std::uintptr_t>(storage_.data());
  std::uint8_t* at = storage_.data() + (rt::kRowAlignment - address % rt::kRowAlignment) % rt::kRowAlignment;
  view_.levels = levels;
  for (int l = 0; l < levels; ++l) {
    level_[l] = {at, width >> l, height >> l, row_bytes(width >> l)};
    view_.level[l] = level_[l];
    at += static_cast<std::ptrdiff_t>(level_[l].stride) * level_[l].height;
  }
}

void BoxMask::mask_box(const Box& box) {
  const float mx = margin_.pixels + margin_.share * box.width(), my = margin_.pixels + margin_.share * box.height();
  for (int l = 0; l < view_.levels; ++l) {
    const rt::MutableImageView& image = level_[l];
    const float shrink = 1.F / static_cast<float>(1 << l);
    // Clamped as floating point first: a huge value must not overflow the conversion.
    const auto edge = [](float v, int limit) {
      return static_cast<int>(std::clamp(v, 0.F, static_cast<float>(limit)));
    };
    const int x0 = edge(std::floor((box.x0 - mx) * shrink - margin_.level_pixels), image.width);
    const int x1 = edge(std::ceil((box.x1 + mx) * shrink + margin_.level_pixels), image.width);
    const int y0 = edge(std::floor((box.y0 - my) * shrink - margin_.level_pixels), image.height);
    const int y1 = edge(std::ceil((box.y1 + my) * shrink + margin_.level_pixels), image.height);
    if (x1 <= x0) continue;
    for (int y = y0; y < y1; ++y) std::memset(image.row(y) + x0, kDynamic, x1 - x0);
  }
}

void BoxMask::update(std::span<const Box> boxes, const std::vector<bool>& movable) {
  std::fill(storage_.begin(), storage_.end(), std::uint8_t{0});
  for (const Box& box : boxes) {
    const bool known = box.class_id >= 0 && box.class_id < std::ssize(movable);
    if (known && !movable[box.class_id]) continue;
    // Also false for NaN.
    const bool sound = std::isfinite(box.x0) && std::isfinite(box.y0) && std::isfinite(box.x1) &&
                       std::isfinite(box.y1) && box.x0 < box.x1 && box.y0 < box.y1;
    if (sound) mask_box(box);
  }
}

}  // namespace godwit::detector
