// Relief: heights on a periodic grid, triangulated; what is drawn is what is measured.
#pragma once

#include <cstdint>
#include <vector>

#include "hal/sim/world/trajectory.h"

namespace godwit::sim {

/// The world repeats itself with this period in x and y, so it has no edge.
constexpr double kWorldM = 409.6;

class Terrain {
 public:
  static constexpr int kCells = 128;
  static constexpr double kCellM = kWorldM / kCells;

  /// relief_m: about the difference between the lowest and the highest point; 0 is flat.
  Terrain(double relief_m, std::uint64_t seed);
  /// Grid corner (i, j), which wraps, lies at (i, j) * kCellM.
  float corner(int i, int j) const {
    constexpr int kMask = kCells - 1;
    return heights_[(j & kMask) * kCells + (i & kMask)];
  }
  /// Height at a point, on the triangles: each cell is cut from its (0, 0) to its (1, 1) corner.
  double height(double x, double y) const;
  /// Unit normal, smoothed over a cell; for shading.
  Vec3 normal(double x, double y) const;

 private:
  std::vector<float> heights_;
};

}  // namespace godwit::sim
