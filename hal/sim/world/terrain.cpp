#include "hal/sim/world/terrain.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "hal/sim/world/random.h"

namespace godwit::sim {

Terrain::Terrain(double relief_m, std::uint64_t seed) : heights_(kCells * kCells, 0.0f) {
  // Value noise, periodic: hills of 205, 102 and 51 m, each half as high as the one before.
  double amplitude = 0.6 * relief_m;
  for (const int cell : {64, 32, 16}) {
    const int n = kCells / cell;
    std::vector<double> lattice(n * n);
    Rng rng(seed, static_cast<std::uint64_t>(cell));
    for (double& v : lattice) v = rng.uniform(-0.5, 0.5);
    const auto at = [&](int i, int j) { return lattice[(j % n) * n + i % n]; };
    const auto smooth = [](double t) { return t * t * t * (t * (6 * t - 15) + 10); };
    for (int j = 0; j < kCells; ++j) {
      for (int i = 0; i < kCells; ++i) {
        const int a = i / cell, b = j / cell;
        const double u = smooth(static_cast<double>(i % cell) / cell), v = smooth(static_cast<double>(j % cell) / cell);
        const double low = at(a, b) + u * (at(a + 1, b) - at(a, b));
        const double high = at(a, b + 1) + u * (at(a + 1, b + 1) - at(a, b + 1));
        heights_[j * kCells + i] += static_cast<float>(amplitude * (low + v * (high - low)));
      }
    }
    amplitude *= 0.5;
  }
}

double Terrain::height(double x, double y) const {
  const double gx = x / kCellM, gy = y / kCellM;
  const double fi = std::floor(gx), fj = std::floor(gy), u = gx - fi, v = gy - fj;
  const int i = static_cast<int>(fi), j = static_cast<int>(fj);
  const double h00 = corner(i, j), h11 = corner(i + 1, j + 1);
  if (u >= v) {
    const double h10 = corner(i + 1, j);
    return h00 + u * (h10 - h00) + v * (h11 - h10);
  }
  const double h01 = corner(i, j + 1);
  return h00 + v * (h01 - h00) + u * (h11 - h01);
}

Vec3 Terrain::normal(double x, double y) const {
  constexpr double d = 0.5 * kCellM;
  const double sx = (height(x + d, y) - height(x - d, y)) / (2 * d),
               sy = (height(x, y + d) - height(x, y - d)) / (2 * d);
  return Vec3(-sx, -sy, 1).normalized();
}

}  // namespace godwit::sim
