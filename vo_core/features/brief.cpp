#include "vo_core/features/brief.h"

#include <algorithm>
#include <cmath>

namespace godwit::vo {
namespace {
/// Sum of uniform numbers, close to a normal one; the same for ever.
class Places {
 public:
  double next() {
    double sum = 0.0;
    for (int i = 0; i < 6; ++i) {
      state_ = state_ * 6364136223846793005ULL + 1442695040888963407ULL;
      sum += static_cast<double>(state_ >> 40) / static_cast<double>(1 << 24) - 0.5;
    }
    return sum * std::sqrt(2.0);  // variance 6 / 12, made 1
  }

 private:
  std::uint64_t state_ = 2010;
};
}  // namespace

BriefPattern::BriefPattern(double roll_rad) {
  const double c = std::cos(roll_rad), s = std::sin(roll_rad);
  // Within a circle, so that no turned place leaves the reach.
  constexpr double kFar = kReach - 2;
  Places places;
  const auto place = [&](std::int8_t* x, std::int8_t* y) {
    double u = kSigma * places.next(), v = kSigma * places.next();
    const double r = std::hypot(u, v);
    if (r > kFar) u *= kFar / r, v *= kFar / r;
    *x = static_cast<std::int8_t>(std::lround(c * u - s * v));
    *y = static_cast<std::int8_t>(std::lround(s * u + c * v));
  };
  for (Pair& p : pairs_) {
    place(&p.x0, &p.y0);
    place(&p.x1, &p.y1);
  }
}

bool BriefPattern::describe(const rt::PyramidView& pyramid, const Vec2f& px, BriefDescriptor* out) const {
  const rt::ImageView& image = pyramid.level[kLevel];
  constexpr float kScale = 1.0f / (1 << kLevel);
  const int x = static_cast<int>(std::lround((px.x() + 0.5f) * kScale - 0.5f));
  const int y = static_cast<int>(std::lround((px.y() + 0.5f) * kScale - 0.5f));
  if (x < kReach || y < kReach || x >= image.width - kReach || y >= image.height - kReach) return false;
  // Four pixels together: single ones are too noisy to compare.
  const auto grey = [&](int dx, int dy) {
    const std::uint8_t* p = image.row(y + dy) + x + dx;
    return p[0] + p[1] + p[image.stride] + p[image.stride + 1];
  };
  for (std::size_t w = 0; w < out->word.size(); ++w) {
    std::uint64_t bits = 0;
    for (std::size_t b = 0; b < 64; ++b) {
      const Pair& p = pairs_[64 * w + b];
      bits |= static_cast<std::uint64_t>(grey(p.x0, p.y0) < grey(p.x1, p.y1)) << b;
    }
    out->word[w] = bits;
  }
  return true;
}

}  // namespace godwit::vo
