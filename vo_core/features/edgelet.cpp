#include "vo_core/features/edgelet.h"

#include <cassert>
#include <cmath>

namespace godwit::vo {

namespace {

/// Eight times the gradient.
struct Gradient {
  int x, y;
  int squared() const { return x * x + y * y; }
};

inline Gradient sobel(const std::uint8_t* p, std::ptrdiff_t stride) {
  const std::uint8_t *a = p - stride, *c = p + stride;
  return {(a[1] - a[-1]) + 2 * (p[1] - p[-1]) + (c[1] - c[-1]), (c[-1] - a[-1]) + 2 * (c[0] - a[0]) + (c[1] - a[1])};
}

}  // namespace

bool find_edgelet(const rt::ImageView& image, const rt::ImageView& mask, int x_begin, int y_begin, int x_end, int y_end,
                  float min_magnitude, Edgelet* edgelet) {
  assert(x_begin >= kEdgeletBorder && y_begin >= kEdgeletBorder);
  assert(x_end <= image.width - kEdgeletBorder && y_end <= image.height - kEdgeletBorder);
  Gradient best{0, 0};
  int best_x = 0, best_y = 0;
  for (int y = y_begin; y < y_end; ++y) {
    for (int x = x_begin; x < x_end; ++x) {
      const Gradient g = sobel(image.row(y) + x, image.stride);
      if (g.squared() <= best.squared() || (!mask.empty() && mask.at(x, y) != 0)) continue;
      best = g;
      best_x = x;
      best_y = y;
    }
  }
  const float length = std::sqrt(static_cast<float>(best.squared()));
  const float magnitude = length / 8.0f;
  if (best.squared() == 0 || magnitude < min_magnitude) return false;
  const Vec2f direction = Vec2f(static_cast<float>(best.x), static_cast<float>(best.y)) / length;
  const int dx = static_cast<int>(std::lround(direction.x())), dy = static_cast<int>(std::lround(direction.y()));
  for (const int side : {-1, 1}) {
    const Gradient g = sobel(image.row(best_y + side * dy) + best_x + side * dx, image.stride);
    if (g.squared() > best.squared()) return false;
  }
  *edgelet = {best_x, best_y, magnitude, direction};
  return true;
}

}  // namespace godwit::vo
