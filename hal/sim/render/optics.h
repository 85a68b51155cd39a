// The simulated lens: for every pixel the ray it sees, and for every ray its pixel.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "hal/sim/world/trajectory.h"

namespace godwit::sim {

/// Pinhole with radial-tangential distortion k1 k2 p1 p2 k3, as OpenCV's projectPoints; pixel (0, 0) is the centre of
/// the top-left pixel.
struct Lens {
  int width = 640, height = 480;
  double fx = 450, fy = 450, cx = 319.5, cy = 239.5;
  std::array<double, 5> distortion{};

  /// Pixel of the ray (x, y, 1).
  Vec2 project(const Vec2& ray) const;
  /// Ray (x, y, 1) of a pixel; iterative, to 1e-12 where it converges.
  Vec2 unproject(const Vec2& px) const;
  /// Largest x^2 + y^2 of a ray in the picture's corners; the distortion must be monotonic up to there.
  bool monotonic() const;
};

constexpr int kTile = 16;  ///< [px] side of the blocks that are drawn at once
constexpr int kTilePixels = kTile * kTile;

/// Rays of all pixels, in rows padded to whole tiles, and bounds of the rays of each tile.
struct RayTable {
  explicit RayTable(const Lens& lens);

  struct Tile {
    float x_min, x_max, y_min, y_max;  ///< bounds of its rays, half a pixel around
    float x_centre, y_centre;          ///< ray of its centre
    float dxdu, dydu, dxdv, dydv;      ///< change of the ray a pixel to the right (u) and down (v)
  };
  int columns, rows;  ///< of tiles
  int stride;         ///< floats a row of x and y
  std::vector<float> x, y;
  std::vector<Tile> tiles;                    ///< row by row
  std::vector<float> column_min, column_max;  ///< bounds of x over a column of tiles
  std::vector<float> row_min, row_max;        ///< bounds of y over a row of tiles
  float x_min, x_max, y_min, y_max;           ///< of the whole picture
};

}  // namespace godwit::sim
