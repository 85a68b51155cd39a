#include "hal/sim/render/optics.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace godwit::sim {

Vec2 Lens::project(const Vec2& ray) const {
  const auto& [k1, k2, p1, p2, k3] = distortion;
  const double x = ray.x(), y = ray.y(), r2 = x * x + y * y;
  const double radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3));
  const double xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x);
  const double yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y;
  return {fx * xd + cx, fy * yd + cy};
}

Vec2 Lens::unproject(const Vec2& px) const {
  // Newton with a numeric Jacobian: runs once for each pixel at start, so clarity comes before speed.
  Vec2 ray((px.x() - cx) / fx, (px.y() - cy) / fy);
  for (int i = 0; i < 20; ++i) {
    const Vec2 error = project(ray) - px;
    if (error.norm() < 1e-10) break;
    constexpr double kStep = 1e-6;
    Eigen::Matrix2d J;
    J.col(0) = (project(ray + Vec2(kStep, 0)) - project(ray - Vec2(kStep, 0))) / (2 * kStep);
    J.col(1) = (project(ray + Vec2(0, kStep)) - project(ray - Vec2(0, kStep))) / (2 * kStep);
    const double det = J(0, 0) * J(1, 1) - J(0, 1) * J(1, 0);
    ray -= Vec2(J(1, 1) * error.x() - J(0, 1) * error.y(), -J(1, 0) * error.x() + J(0, 0) * error.y()) / det;
  }
  return ray;
}

bool Lens::monotonic() const {
  double corner = 0;
  for (const double u : {-1.0, static_cast<double>(width)}) {
    for (const double v : {-1.0, static_cast<double>(height)}) {
      corner = std::max(corner, std::hypot((u - cx) / fx, (v - cy) / fy));
    }
  }
  // The distorted radius must grow until it has reached the corner.
  double last = 0;
  for (double r = 0.001; r < 10; r += 0.001) {
    const double r2 = r * r;
    const double d = r * (1 + r2 * (distortion[0] + r2 * (distortion[1] + r2 * distortion[4])));
    if (d <= last) return false;
    if (d > corner * 1.02) return true;
    last = d;
  }
  return false;
}

RayTable::RayTable(const Lens& lens)
    : columns((lens.width + kTile - 1) / kTile), rows((lens.height + kTile - 1) / kTile), stride(columns * kTile) {
  const std::size_t count = stride * (rows * kTile);
  x.resize(count);
  y.resize(count);
  for (int v = 0; v < rows * kTile; ++v) {
    for (int u = 0; u < stride; ++u) {
      // Padding repeats the picture's last pixel: it is drawn and thrown away.
      const Vec2 ray = lens.unproject(Vec2(std::min(u, lens.width - 1), std::min(v, lens.height - 1)));
      const std::size_t i = v * stride + u;
      x[i] = static_cast<float>(ray.x());
      y[i] = static_cast<float>(ray.y());
    }
  }
  constexpr float kInf = std::numeric_limits<float>::infinity();
  column_min.assign(columns, kInf);
  column_max.assign(columns, -kInf);
  row_min.assign(rows, kInf);
  row_max.assign(rows, -kInf);
  x_min = y_min = kInf;
  x_max = y_max = -kInf;
  for (int r = 0; r < rows; ++r) {
    for (int c = 0; c < columns; ++c) {
      Tile tile{kInf, -kInf, kInf, -kInf, 0, 0, 0, 0, 0, 0};
      const double u0 = c * kTile - 0.5, v0 = r * kTile - 0.5;
      for (int k = 0; k <= 4; ++k) {  // the border bulges: look at five points a side
        for (const Vec2& p : {Vec2(u0 + k * kTile / 4.0, v0), Vec2(u0 + k * kTile / 4.0, v0 + kTile),
                              Vec2(u0, v0 + k * kTile / 4.0), Vec2(u0 + kTile, v0 + k * kTile / 4.0)}) {
          const Vec2 ray = lens.unproject(p);
          tile.x_min = std::min(tile.x_min, static_cast<float>(ray.x()));
          tile.x_max = std::max(tile.x_max, static_cast<float>(ray.x()));
          tile.y_min = std::min(tile.y_min, static_cast<float>(ray.y()));
          tile.y_max = std::max(tile.y_max, static_cast<float>(ray.y()));
        }
      }
      const Vec2 centre(u0 + kTile / 2.0, v0 + kTile / 2.0), ray = lens.unproject(centre);
      const Vec2 du = (lens.unproject(centre + Vec2(1, 0)) - lens.unproject(centre - Vec2(1, 0))) / 2;
      const Vec2 dv = (lens.unproject(centre + Vec2(0, 1)) - lens.unproject(centre - Vec2(0, 1))) / 2;
      tile.x_centre = static_cast<float>(ray.x());
      tile.y_centre = static_cast<float>(ray.y());
      tile.dxdu = static_cast<float>(du.x());
      tile.dydu = static_cast<float>(du.y());
      tile.dxdv = static_cast<float>(dv.x());
      tile.dydv = static_cast<float>(dv.y());
      tiles.push_back(tile);
      column_min[c] = std::min(column_min[c], tile.x_min);
      column_max[c] = std::max(column_max[c], tile.x_max);
      row_min[r] = std::min(row_min[r], tile.y_min);
      row_max[r] = std::max(row_max[r], tile.y_max);
      x_min = std::min(x_min, tile.x_min);
      x_max = std::max(x_max, tile.x_max);
      y_min = std::min(y_min, tile.y_min);
      y_max = std::max(y_max, tile.y_max);
    }
  }
}

}  // namespace godwit::sim
