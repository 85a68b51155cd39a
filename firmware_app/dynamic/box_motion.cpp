#include "firmware_app/dynamic/box_motion.h"

#include <algorithm>
#include <array>
#include <cstdlib>
#include <limits>

namespace godwit::app {
namespace {
constexpr int kPointsPerBox = 4;
/// Least side of what is compared [small pixels]: less has no picture.
constexpr int kLeastSide = 4;
}  // namespace

BoxMotion::BoxMotion(int width, int height)
    : width_(width / kShrink),
      height_(height / kShrink),
      before_(static_cast<std::size_t>(width_ * height_)),
      now_(before_.size()) {
  motions_.reserve(kMaxBoxes * kPointsPerBox);
}

void BoxMotion::shrink(const rt::ImageView& grey) {
  for (int y = 0; y < height_; ++y) {
    std::uint8_t* out = now_.data() + static_cast<std::ptrdiff_t>(y) * width_;
    std::array<const std::uint8_t*, kShrink> row;
    for (int k = 0; k < kShrink; ++k) row[static_cast<std::size_t>(k)] = grey.row(y * kShrink + k);
    for (int x = 0; x < width_; ++x) {
      int sum = 0;
      for (const std::uint8_t* r : row)
        for (int k = 0; k < kShrink; ++k) sum += r[x * kShrink + k];
      out[x] = static_cast<std::uint8_t>(sum / (kShrink * kShrink));
    }
  }
}

bool BoxMotion::follow(const detector::Box& box, float* dx, float* dy) const {
  // The middle part: the edges of a box show what lies behind.
  const float inset_x = 0.15F * box.width(), inset_y = 0.1F * box.height();
  const int x0 = std::max(0, static_cast<int>((box.x0 + inset_x) / kShrink));
  const int y0 = std::max(0, static_cast<int>((box.y0 + inset_y) / kShrink));
  const int x1 = std::min(width_, static_cast<int>((box.x1 - inset_x) / kShrink));
  const int y1 = std::min(height_, static_cast<int>((box.y1 - inset_y) / kShrink));
  if (x1 - x0 < kLeastSide || y1 - y0 < kLeastSide) return false;
  int thin = 1;
  while ((x1 - x0) * ((y1 - y0 + thin - 1) / thin) > kMaxPixels) ++thin;

  constexpr int kSide = 2 * kReach + 1;
  std::array<float, static_cast<std::size_t>(kSide * kSide)> cost;
  int best = -1;
  for (int v = -kReach; v <= kReach; ++v) {
    for (int u = -kReach; u <= kReach; ++u) {
      const int k = (v + kReach) * kSide + u + kReach;
      float& c = cost[static_cast<std::size_t>(k)];
      c = std::numeric_limits<float>::max();
      const int a = std::max(x0, -u), b = std::min(x1, width_ - u);
      int sum = 0, count = 0;
      for (int y = y0; y < y1; y += thin) {
        if (y + v < 0 || y + v >= height_ || b <= a) continue;
        const std::uint8_t* p = before_.data() + static_cast<std::ptrdiff_t>(y) * width_;
        const std::uint8_t* q = now_.data() + static_cast<std::ptrdiff_t>(y + v) * width_ + u;
        for (int x = a; x < b; ++x) sum += std::abs(p[x] - q[x]);
        count += b - a;
      }
      if (2 * count * thin < (x1 - x0) * (y1 - y0)) continue;  // more than half of it would have left the picture
      c = static_cast<float>(sum) / static_cast<float>(count);
      if (best < 0 || c < cost[static_cast<std::size_t>(best)]) best = k;
    }
  }
  if (best < 0) return false;
  const int u = best % kSide - kReach, v = best / kSide - kReach;
  // Between whole pixels: the minimum of two straight slopes, which the sum of absolute differences has.
  const auto part = [&](int step, bool inside) {
    if (!inside) return 0.F;
    const float l = cost[static_cast<std::size_t>(best - step)], r = cost[static_cast<std::size_t>(best + step)];
    const float c = cost[static_cast<std::size_t>(best)];
    if (l == std::numeric_limits<float>::max() || r == std::numeric_limits<float>::max()) return 0.F;
    const float slope = std::max(l, r) - c;
    return slope > 0.F ? 0.5F * (l - r) / slope : 0.F;
  };
  *dx = kShrink * (static_cast<float>(u) + part(1, u > -kReach && u < kReach));
  *dy = kShrink * (static_cast<float>(v) + part(kSide, v > -kReach && v < kReach));
  return true;
}

std::span<const detector::FeatureMotion> BoxMotion::next(const rt::ImageView& grey,
                                                         std::span<const detector::Box> boxes) {
  std::swap(before_, now_);
  shrink(grey);
  motions_.clear();
  if (have_before_) {
    for (const detector::Box& box : boxes.first(std::min<std::size_t>(boxes.size(), kMaxBoxes))) {
      float dx = 0.F, dy = 0.F;
      if (!follow(box, &dx, &dy)) continue;
      for (int k = 0; k < kPointsPerBox; ++k) {
        const float x = box.x0 + box.width() * (k % 2 == 0 ? 0.35F : 0.65F);
        const float y = box.y0 + box.height() * (k / 2 == 0 ? 0.35F : 0.65F);
        motions_.push_back({x, y, x + dx, y + dy});
      }
    }
  }
  have_before_ = true;
  return motions_;
}

}  // namespace godwit::app
