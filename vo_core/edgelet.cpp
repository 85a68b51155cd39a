#include "vo_core/edgelet.h"

#include <cassert>
#include <cmath>

namespace godwit::vo {

bool find_edgelet(const rt::ImageView& image, const rt::ImageView& mask, int x_begin, int y_begin, int x_end, int y_end,
                  float min_magnitude, Edgelet* edgelet) {
  assert(x_begin >= 1 && y_begin >= 1 && x_end < image.width && y_end < image.height);
  // The Sobel operator sums to eight times the gradient.
  constexpr float kSobel = 8.0f;
  int best2 = -1, best_x = 0, best_y = 0, best_gx = 0, best_gy = 0;
  for (int y = y_begin; y < y_end; ++y) {
    const std::uint8_t* a = image.row(y - 1);
    const std::uint8_t* b = image.row(y);
    const std::uint8_t* c = image.row(y + 1);
    for (int x = x_begin; x < x_end; ++x) {
      const int gx = (a[x + 1] - a[x - 1]) + 2 * (b[x + 1] - b[x - 1]) + (c[x + 1] - c[x - 1]);
      const int gy = (c[x - 1] - a[x - 1]) + 2 * (c[x] - a[x]) + (c[x + 1] - a[x + 1]);
      const int magnitude2 = gx * gx + gy * gy;
      if (magnitude2 <= best2 || (!mask.empty() && mask.at(x, y) != 0)) continue;
      best2 = magnitude2;
      best_x = x;
      best_y = y;
      best_gx = gx;
      best_gy = gy;
    }
  }
  if (best2 <= 0) return false;
  const float magnitude = std::sqrt(static_cast<float>(best2)) / kSobel;
  if (magnitude < min_magnitude) return false;
  edgelet->x = best_x;
  edgelet->y = best_y;
  edgelet->magnitude = magnitude;
  edgelet->direction = Vec2f(static_cast<float>(best_gx), static_cast<float>(best_gy)).normalized();
  return true;
}

}  // namespace godwit::vo
