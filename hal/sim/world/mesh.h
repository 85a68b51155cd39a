// Things made of flat faces, each with a material laid on it.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "hal/sim/world/random.h"
#include "hal/sim/world/trajectory.h"

namespace godwit::sim {

using Vec3f = Eigen::Vector3f;

/// A flat (or, for the terrain, nearly flat) face's material. Texel of a point p: ((p - origin).u + u0, (p - origin).v
/// + v0).
struct Surface {
  int texture = 0;
  Vec3f origin = Vec3f::Zero(), u = Vec3f::UnitX(), v = Vec3f::UnitY();  ///< u, v: texels a metre along an axis
  float u0 = 0, v0 = 0;
  Vec3f normal = Vec3f::UnitZ();
  float detail_ratio = 10;  ///< texels of the fine detail to one texel of the material
  float albedo = 1;         ///< multiplies the material's brightness
  float light = 1;          ///< irradiance relative to flat ground in the sun; set by the world
  bool emits = false;       ///< a lamp: light does not change it
};

struct MeshTriangle {
  std::uint32_t vertex[3];  ///< counter-clockwise seen from outside
  std::uint32_t surface;
};

/// How a face is to be covered.
struct Cover {
  int texture = 0;
  double texels_per_m = 32;  ///< 0: the whole picture is stretched over the face
  double albedo = 1;
  double u0 = 0, v0 = 0;  ///< texels
  bool emits = false;
};

/// Faces that are moved and hidden together.
struct Mesh {
  std::vector<Vec3f> vertices;
  std::vector<MeshTriangle> triangles;
  std::vector<Surface> surfaces;

  /// Corners as seen from outside: top left, top right, bottom right, bottom left. u runs left to right, v down.
  void quad(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d, const Cover& cover);
  /// Counter-clockwise from outside; u along a to b.
  void triangle(const Vec3& a, const Vec3& b, const Vec3& c, const Cover& cover);
  /// Upright box, heading given by the unit vector (dx, dy); half extents along and across it. Sides and top, no
  /// bottom.
  void box(const Vec3& centre_bottom, double dx, double dy, double half_along, double half_across, double height,
           const Cover& ends, const Cover& sides, const Cover& top);
  /// Upright prism or truncated cone of n sides with a cap.
  void prism(const Vec3& centre_bottom, int n, double radius_bottom, double radius_top, double height,
             const Cover& side, const Cover& cap);
  /// Crumpled ellipsoid of 80 faces.
  void blob(const Vec3& centre, double radius_across, double radius_up, double crumple, const Cover& cover, Rng* rng);
  /// House roof over a box: ridge along (dx, dy), gable walls covered by `gable`.
  void gable_roof(const Vec3& centre_eaves, double dx, double dy, double half_along, double half_across, double height,
                  const Cover& slope, const Cover& gable);
};

}  // namespace godwit::sim
