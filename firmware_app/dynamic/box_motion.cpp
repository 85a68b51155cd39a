#include "firmware_app/dynamic/box_motion.h"

#include <algorithm>
#include <climits>
#include <cstdlib>
#include <limits>

namespace godwit::app {
namespace {
constexpr int kPointsPerBox = 4;
/// Least side of what is compared [small pixels]: less has no picture.
constexpr int kLeastSide = 4;
/// Mean difference by which a shift must be worse than the best to tell the two apart [grey levels].
constexpr float kLeastContrast = 1.F;
constexpr float kNoCost = std::numeric_limits<float>::max();

/// 0, -1, 1, -2, 2, ...
int outwards(int i) {
  return i % 2 == 0 ? i / 2 : -(i + 1) / 2;
}

/// Sum of absolute differences. In pieces of fixed length, which the compiler makes one instruction of.
int difference(const std::uint8_t* p, const std::uint8_t* q, int n) {
  constexpr int kPiece = 8;
  int sum = 0, x = 0;
  for (; x + kPiece <= n; x += kPiece)
    for (int k = 0; k < kPiece; ++k) sum += std::abs(p[x + k] - q[x + k]);
  for (; x < n; ++x) sum += std::abs(p[x] - q[x]);
  return sum;
}
}  // namespace

BoxMotion::BoxMotion(int width, int height)
    : width_(width / kShrink),
      height_(height / kShrink),
      before_(width_ * height_),
      now_(before_.size()),
      columns_(width_ * kShrink) {
  static_assert(kShrink == 4, "shrink() adds four rows");
  motions_.reserve(kMaxBoxes * kPointsPerBox);
}

void BoxMotion::shrink(const rt::ImageView& grey) {
  // First down the columns, then along the row: in this order the compiler makes vectors of it.
  std::uint16_t* const column = columns_.data();
  for (int y = 0; y < height_; ++y) {
    const std::uint8_t* r0 = grey.row(y * kShrink);
    const std::uint8_t* r1 = grey.row(y * kShrink + 1);
    const std::uint8_t* r2 = grey.row(y * kShrink + 2);
    const std::uint8_t* r3 = grey.row(y * kShrink + 3);
    for (int x = 0; x < width_ * kShrink; ++x) column[x] = static_cast<std::uint16_t>(r0[x] + r1[x] + r2[x] + r3[x]);
    std::uint8_t* out = now_.data() + static_cast<std::ptrdiff_t>(y) * width_;
    for (int x = 0; x < width_; ++x) {
      const std::uint16_t* c = column + x * kShrink;
      out[x] = static_cast<std::uint8_t>((c[0] + c[1] + c[2] + c[3]) / (kShrink * kShrink));
    }
  }
}

bool BoxMotion::follow(const detector::Box& box, float* dx, float* dy) const {
  // The middle part: the edges of a box show what lies behind.
  const float inset_x = 0.15F * box.width(), inset_y = 0.1F * box.height();
  // Clipped while it is still floating: a box may be anywhere.
  const auto within = [](float px, int size) {
    return static_cast<int>(std::clamp(px / kShrink, 0.F, static_cast<float>(size)));
  };
  const int x0 = within(box.x0 + inset_x, width_), x1 = within(box.x1 - inset_x, width_);
  const int y0 = within(box.y0 + inset_y, height_), y1 = within(box.y1 - inset_y, height_);
  if (x1 - x0 < kLeastSide || y1 - y0 < kLeastSide) return false;
  int thin = 1;
  while ((x1 - x0) * ((y1 - y0 + thin - 1) / thin) > kMaxPixels) ++thin;

  // Mean difference when the box has moved by (u, v), or kNoCost: more than half of it would have left the picture, or
  // it is found out half way to be more than `limit`.
  const auto cost = [&](int u, int v, float limit) {
    const int a = std::max(x0, -u), b = std::min(x1, width_ - u);
    int rows = 0;
    for (int y = y0; y < y1; y += thin) rows += y + v >= 0 && y + v < height_;
    const int count = rows * std::max(b - a, 0);
    if (count == 0 || 2 * count * thin < (x1 - x0) * (y1 - y0)) return kNoCost;
    const int most = limit < kNoCost ? static_cast<int>(limit * static_cast<float>(count)) + 1 : INT_MAX;
    int sum = 0;
    for (int y = y0; y < y1 && sum <= most; y += thin) {
      if (y + v < 0 || y + v >= height_) continue;
      const std::ptrdiff_t row = static_cast<std::ptrdiff_t>(y) * width_;
      sum += difference(before_.data() + row + a, now_.data() + row + static_cast<std::ptrdiff_t>(v) * width_ + u + a,
                        b - a);
    }
    return sum <= most ? static_cast<float>(sum) / static_cast<float>(count) : kNoCost;
  };
  // From the middle outwards: most things have moved little, and what is known of the best spares most of the others
  // their last rows.
  float least = kNoCost;
  int u = 0, v = 0;
  for (int i = 0; i <= 2 * kReach; ++i) {
    for (int j = 0; j <= 2 * kReach; ++j) {
      const int cu = outwards(j), cv = outwards(i);
      const float c = cost(cu, cv, least);
      if (c >= least) continue;
      least = c;
      u = cu;
      v = cv;
    }
  }
  if (least == kNoCost) return false;
  // Where even the farthest shift is hardly worse, nothing is known of how it moved.
  const float worse = least + kLeastContrast;
  if (cost(kReach, 0, worse) != kNoCost && cost(-kReach, 0, worse) != kNoCost && cost(0, kReach, worse) != kNoCost &&
      cost(0, -kReach, worse) != kNoCost)
    return false;
  // Between whole pixels: the minimum of two straight slopes, which the sum of absolute differences has.
  const auto part = [&](int du, int dv) {
    if (std::abs(u) * du == kReach || std::abs(v) * dv == kReach) return 0.F;
    const float l = cost(u - du, v - dv, kNoCost), r = cost(u + du, v + dv, kNoCost);
    if (l == kNoCost || r == kNoCost) return 0.F;
    const float slope = std::max(l, r) - least;
    return slope > 0.F ? 0.5F * (l - r) / slope : 0.F;
  };
  *dx = kShrink * (static_cast<float>(u) + part(1, 0));
  *dy = kShrink * (static_cast<float>(v) + part(0, 1));
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
