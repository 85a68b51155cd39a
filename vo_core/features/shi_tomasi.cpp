#include "vo_core/features/shi_tomasi.h"

#include <cmath>
#include <hwy/highway.h>

namespace godwit::vo {

namespace hn = hwy::HWY_NAMESPACE;

float shi_tomasi(const rt::ImageView& image, int x, int y) {
  if (x < kShiTomasiBorder || y < kShiTomasiBorder || x >= image.width - kShiTomasiBorder ||
      y >= image.height - kShiTomasiBorder) {
    return 0.0f;
  }
  const hn::FixedTag<std::uint8_t, 8> d8;
  const hn::FixedTag<std::int16_t, 8> d16;
  const hn::FixedTag<std::int32_t, 4> d32;
  const auto load = [&](const std::uint8_t* p) { return hn::PromoteTo(d16, hn::LoadU(d8, p)); };

  auto xx = hn::Zero(d32), xy = hn::Zero(d32), yy = hn::Zero(d32);
  auto xx_odd = hn::Zero(d32), xy_odd = hn::Zero(d32), yy_odd = hn::Zero(d32);
  const std::uint8_t* row = image.row(y - 4) + x - 4;
  auto above = load(row - image.stride);
  auto middle = load(row);
  for (int i = 0; i < 8; ++i) {
    const auto below = load(row + image.stride);
    const auto gx = hn::Sub(load(row + 1), load(row - 1));
    const auto gy = hn::Sub(below, above);
    // Largest sum: 64 * 255^2 = 4.2e6.
    xx = hn::ReorderWidenMulAccumulate(d32, gx, gx, xx, xx_odd);
    xy = hn::ReorderWidenMulAccumulate(d32, gx, gy, xy, xy_odd);
    yy = hn::ReorderWidenMulAccumulate(d32, gy, gy, yy, yy_odd);
    above = middle;
    middle = below;
    row += image.stride;
  }
  const auto total = [&](auto even, auto odd) {
    return static_cast<float>(hn::GetLane(hn::SumOfLanes(d32, hn::Add(even, odd))));
  };
  // 64 pixels, and a factor of 2 in each gradient.
  constexpr float kScale = 1.0f / 256.0f;
  const float a = kScale * total(xx, xx_odd), b = kScale * total(xy, xy_odd), c = kScale * total(yy, yy_odd);
  const float half_difference = 0.5f * (a - c);
  return 0.5f * (a + c) - std::sqrt(half_difference * half_difference + b * b);
}

}  // namespace godwit::vo
