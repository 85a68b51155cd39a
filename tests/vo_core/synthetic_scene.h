// Textured rectangles in space, rendered through a camera: picture sequences with exact truth.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <map>
#include <vector>

#include "tests/vo_core/synthetic_picture.h"
#include "vo_core/geometry/camera_model.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::vo::test {

/// Smooth grey noise over the plane: value noise of three octaves, the same everywhere and always.
inline double texture(double x, double y, std::uint32_t seed) {
  const auto value = [](std::int64_t i, std::int64_t j, std::uint32_t s) {
    std::uint64_t h = static_cast<std::uint64_t>(i) * 0x9e3779b97f4a7c15ULL ^
                      static_cast<std::uint64_t>(j) * 0xc2b2ae3d27d4eb4fULL ^ s;
    h ^= h >> 31;
    h *= 0xbf58476d1ce4e5b9ULL;
    h ^= h >> 29;
    h *= 0x94d049bb133111ebULL;
    return static_cast<double>(h >> 40) / static_cast<double>(1 << 24);
  };
  double sum = 0, weight = 0.5;
  for (std::uint32_t octave = 0; octave < 3; ++octave, weight *= 0.6, x *= 2.3, y *= 2.3) {
    const double fx = std::floor(x), fy = std::floor(y);
    const auto i = static_cast<std::int64_t>(fx), j = static_cast<std::int64_t>(fy);
    const auto smooth = [](double t) { return t * t * (3 - 2 * t); };
    const double u = smooth(x - fx), v = smooth(y - fy);
    const std::uint32_t s = seed * 31 + octave;
    const double top = (1 - u) * value(i, j, s) + u * value(i + 1, j, s);
    const double bottom = (1 - u) * value(i, j + 1, s) + u * value(i + 1, j + 1, s);
    sum += weight * ((1 - v) * top + v * bottom);
  }
  return sum;
}

/// Bearing of each pixel, row by row: found by iteration, and the same for every picture of a flight.
inline const std::vector<Vec3>& bearings(const CameraModel& camera) {
  const int width = camera.width(), height = camera.height();
  // No two cameras agree in all of these.
  std::vector<double> key{1.0 * width, 1.0 * height};
  for (const Vec2& px : {Vec2(0, 0), Vec2(width - 1, 0), Vec2(0, height - 1), Vec2(width / 3, height / 4)}) {
    const Vec3 bearing = camera.unproject(px);
    key.insert(key.end(), bearing.data(), bearing.data() + 3);
  }
  thread_local std::map<std::vector<double>, std::vector<Vec3>> all;
  std::vector<Vec3>& out = all[key];
  if (!out.empty()) return out;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) out.push_back(camera.unproject(Vec2(x, y)));
  }
  return out;
}

/// A rectangle: points centre + a * right + b * down, |a| and |b| within the half sizes.
struct Board {
  Vec3 centre, right, down;  ///< right, down: unit length, at right angles
  double half_width, half_height;
  std::uint32_t seed;

  /// Distance along the ray (in units of its length), or a negative number.
  double hit(const Vec3& origin, const Vec3& ray, double* a, double* b) const {
    const Vec3 normal = right.cross(down);
    const double d = normal.dot(ray);
    if (std::abs(d) < 1e-9) return -1;
    const double s = normal.dot(centre - origin) / d;
    const Vec3 p = origin + s * ray - centre;
    *a = p.dot(right);
    *b = p.dot(down);
    return std::abs(*a) <= half_width && std::abs(*b) <= half_height ? s : -1;
  }
};

struct SyntheticScene {
  std::vector<Board> boards;

  /// One slanted plane that fills the view.
  static SyntheticScene plane() {
    const Vec3 right = Vec3(1, 0, -0.3).normalized();
    const Vec3 down = Vec3(0, 0, 1).cross(right).normalized();
    return {{{Vec3(0, 0, 3), right, down - down.dot(right) * right, 12, 12, 7}}};
  }

  /// Boards at many depths before a wall.
  static SyntheticScene general() {
    SyntheticScene s;
    s.boards.push_back({Vec3(0, 0, 6), Vec3::UnitX(), Vec3::UnitY(), 20, 20, 3});
    for (int i = 0; i < 5; ++i) {
      for (int j = 0; j < 4; ++j) {
        const double z = 1.6 + 0.9 * ((7 * i + 3 * j) % 5);
        const double x = (i - 2) * 0.25 * z, y = (j - 1.5) * 0.25 * z;
        s.boards.push_back({Vec3(x, y, z), Vec3::UnitX(), Vec3::UnitY(), 0.1 * z, 0.1 * z,
                            static_cast<std::uint32_t>(11 + 5 * i + j)});
      }
    }
    return s;
  }

  /// Depth (z in the camera frame) at a pixel, or 0.
  double depth(const CameraModel& camera, const SE3& T_cam_world, const Vec2& px) const {
    const SE3 T = T_cam_world.inverse();
    double nearest = 0, a = 0, b = 0;
    const Vec3 bearing = camera.unproject(px);
    for (const Board& board : boards) {
      const double s = board.hit(T.t, T.R * bearing, &a, &b);
      if (s > 0 && (nearest == 0 || s < nearest)) nearest = s;
    }
    return nearest * bearing.z();
  }

  Picture render(const CameraModel& camera, const SE3& T_cam_world, double gain = 1.0, double offset = 0.0) const {
    return render_rows(
        camera, [&](int) { return T_cam_world; }, gain, offset);
  }

  /// Every row with a pose of its own, as a rolling shutter does: pose(y) is T_cam_world.
  template <typename Pose>
  Picture render_rows(const CameraModel& camera, const Pose& pose, double gain = 1.0, double offset = 0.0) const {
    Picture picture(camera.width(), camera.height(), 0);
    const Vec3* bearing = bearings(camera).data();
    std::vector<Seen> seen, in_row;
    SE3 seen_from;
    for (int y = 0; y < camera.height(); ++y) {
      const SE3 T_cam_world = pose(y);
      if (y == 0 || T_cam_world.R != seen_from.R || T_cam_world.t != seen_from.t) {
        seen_from = T_cam_world;
        seen.clear();
        for (const Board& board : boards) seen.push_back(see(camera, T_cam_world, board));
      }
      in_row.clear();
      std::copy_if(seen.begin(), seen.end(), std::back_inserter(in_row),
                   [y](const Seen& s) { return y >= s.top && y <= s.bottom; });
      const SE3 T = T_cam_world.inverse();
      for (int x = 0; x < camera.width(); ++x) {
        const Vec3 ray = T.R * *bearing++;
        double nearest = 1e9, at_a = 0, at_b = 0;
        const Board* hit = nullptr;
        for (const Seen& near : in_row) {
          if (x < near.left || x > near.right) continue;
          double a = 0, b = 0;
          const double s = near.board->hit(T.t, ray, &a, &b);
          if (s <= 0 || s >= nearest) continue;
          nearest = s;
          hit = near.board;
          at_a = a;
          at_b = b;
        }
        // About 12 px a cell at a focal length of 500 px.
        const double per_m = hit != nullptr ? 40.0 / hit->centre.z() : 0;
        const double grey = hit != nullptr ? texture(per_m * at_a, per_m * at_b, hit->seed) : 0.5;
        picture(x, y) = static_cast<std::uint8_t>(std::clamp(std::lround(gain * 230.0 * grey + offset), 0L, 255L));
      }
    }
    return picture;
  }

 private:
  /// A board and the pixels outside of which it is not seen.
  struct Seen {
    const Board* board;
    double left, right, top, bottom;
  };

  /// Most pixels see one board, and asking all 21 for each took nine tenths of the time of drawing.
  static Seen see(const CameraModel& camera, const SE3& T_cam_world, const Board& board) {
    constexpr int kSteps = 8;          // places along each side, which a lens bends
    constexpr double kMargin = 4;      // [px], more than it bends between two of them
    constexpr double kInfinite = 1e9;  // where a part of it lies beside or behind the camera: everywhere
    Seen out{&board, kInfinite, -kInfinite, kInfinite, -kInfinite};
    for (int side = 0; side < 4; ++side) {
      for (int step = 0; step < kSteps; ++step) {
        const double along = 2.0 * step / (kSteps - 1) - 1, across = side % 2 == 0 ? 1 : -1;
        const double a = board.half_width * (side < 2 ? along : across),
                     b = board.half_height * (side < 2 ? across : -along);
        const Vec3 p = T_cam_world * (board.centre + a * board.right + b * board.down);
        Vec2 px;
        if (p.z() < 0.2 * p.norm() || !camera.project(p, &px))
          return {&board, -kInfinite, kInfinite, -kInfinite, kInfinite};
        out.left = std::min(out.left, px.x() - kMargin);
        out.right = std::max(out.right, px.x() + kMargin);
        out.top = std::min(out.top, px.y() - kMargin);
        out.bottom = std::max(out.bottom, px.y() + kMargin);
      }
    }
    return out;
  }
};

}  // namespace godwit::vo::test
