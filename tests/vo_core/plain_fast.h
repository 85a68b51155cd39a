// What the quadtree is measured against: plain FAST, which takes the strongest corners wherever they are.
#pragma once

#include <algorithm>
#include <set>
#include <vector>

#include "hal/rt/image.h"
#include "tests/vo_core/synthetic_picture.h"
#include "vo_core/features/fast_corner.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::vo::test {

/// The `wanted` strongest FAST-9 corners above threshold 20 after 3x3 non-maximum suppression, none in the mask.
inline std::vector<Vec2f> plain_fast(const rt::ImageView& image, const rt::ImageView& mask, int wanted) {
  constexpr int kBorder = 8, kThreshold = 20;
  const auto score = [&](int x, int y) { return fast_score(image, x, y); };
  std::vector<std::pair<int, Vec2f>> corners;
  for (int y = kBorder; y < image.height - kBorder; ++y) {
    for (int x = kBorder; x < image.width - kBorder; ++x) {
      const int s = mask.at(x, y) != 0 ? 0 : score(x, y);
      if (s <= kThreshold) continue;
      bool best = true;
      for (int dy = -1; dy <= 1; ++dy) {
        for (int dx = -1; dx <= 1; ++dx) best = best && ((dx == 0 && dy == 0) || score(x + dx, y + dy) < s);
      }
      if (best) corners.emplace_back(s, Vec2f(static_cast<float>(x), static_cast<float>(y)));
    }
  }
  std::stable_sort(corners.begin(), corners.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
  std::vector<Vec2f> points;
  for (std::size_t i = 0; i < corners.size() && i < static_cast<std::size_t>(wanted); ++i) {
    points.push_back(corners[i].second);
  }
  return points;
}

/// Cells of an 8x6 grid that hold a point.
inline int occupied_cells(const std::vector<Vec2f>& points, int width, int height) {
  std::set<int> cells;
  for (const Vec2f& p : points) {
    cells.insert(static_cast<int>(p.x()) * 8 / width + 8 * (static_cast<int>(p.y()) * 6 / height));
  }
  return static_cast<int>(cells.size());
}

/// Two upright figures that cover a little more than 36 % of the picture.
inline Mask two_walkers(int width, int height) {
  const auto x = [&](double share) { return static_cast<int>(share * width); };
  const auto y = [&](double share) { return static_cast<int>(share * height); };
  Mask mask(width, height);
  for (const double left : {0.12, 0.58}) {
    mask.add_rectangle(x(left + 0.06), y(0.10), x(left + 0.18), y(0.30));  // head
    mask.add_rectangle(x(left), y(0.30), x(left + 0.25), y(0.75));         // shoulders to hip
    mask.add_rectangle(x(left + 0.03), y(0.75), x(left + 0.21), y(1.0));   // legs
  }
  return mask;
}

}  // namespace godwit::vo::test
