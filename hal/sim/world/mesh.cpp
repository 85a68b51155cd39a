#include "hal/sim/world/mesh.h"

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>

#include "hal/sim/world/texture.h"

namespace godwit::sim {
namespace {

int material_size(int texture) {
  switch (texture) {
    case kTexTruckSide0:
    case kTexTruckSide1:
    case kTexFacade0:
    case kTexFacade1:
    case kTexFacade2:
    case kTexFacade3:
      return 512;
    case kTexBark:
    case kTexCloth0:
    case kTexCloth1:
    case kTexCloth2:
      return 128;
    case kTexDetail:
      return 1024;
    default:
      return 256;
  }
}

Surface lay(const Cover& cover, const Vec3& origin, const Vec3& along, const Vec3& down, const Vec3& normal) {
  const double size = material_size(cover.texture);
  const double su = cover.texels_per_m > 0 ? cover.texels_per_m : size / along.norm();
  const double sv = cover.texels_per_m > 0 ? cover.texels_per_m : size / down.norm();
  Surface s;
  s.texture = cover.texture;
  s.origin = origin.cast<float>();
  s.u = (along.normalized() * su).cast<float>();
  s.v = (down.normalized() * sv).cast<float>();
  s.u0 = static_cast<float>(cover.u0);
  s.v0 = static_cast<float>(cover.v0);
  s.normal = normal.normalized().cast<float>();
  s.detail_ratio = static_cast<float>(kDetailTexelsPerM / std::max(su, sv));
  s.albedo = static_cast<float>(cover.albedo);
  s.emits = cover.emits;
  return s;
}

}  // namespace

void Mesh::quad(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d, const Cover& cover) {
  const std::uint32_t first = static_cast<std::uint32_t>(vertices.size());
  const std::uint32_t surface = static_cast<std::uint32_t>(surfaces.size());
  const Vec3 normal = (d - a).cross(c - a);
  Vec3 along = b - a, down = d - a;
  if (along.norm() < 1e-6) along = c - d;
  surfaces.push_back(lay(cover, a, along, down, normal));
  for (const Vec3& p : {a, b, c, d}) vertices.push_back(p.cast<float>());
  triangles.push_back({{first, first + 3, first + 2}, surface});
  triangles.push_back({{first, first + 2, first + 1}, surface});
}

void Mesh::triangle(const Vec3& a, const Vec3& b, const Vec3& c, const Cover& cover) {
  const std::uint32_t first = static_cast<std::uint32_t>(vertices.size());
  const Vec3 normal = (b - a).cross(c - a);
  triangles.push_back({{first, first + 1, first + 2}, static_cast<std::uint32_t>(surfaces.size())});
  surfaces.push_back(lay(cover, a, b - a, (b - a).cross(normal), normal));
  for (const Vec3& p : {a, b, c}) vertices.push_back(p.cast<float>());
}

void Mesh::box(const Vec3& centre_bottom, double dx, double dy, double half_along, double half_across, double height,
               const Cover& ends, const Cover& sides, const Cover& top) {
  const Vec3 l = half_along * Vec3(dx, dy, 0), w = half_across * Vec3(-dy, dx, 0), h(0, 0, height);
  const Vec3 front_left = centre_bottom + l + w, front_right = centre_bottom + l - w;
  const Vec3 back_left = centre_bottom - l + w, back_right = centre_bottom - l - w;
  // Seen from ahead, the box's left is on the right hand.
  quad(front_right + h, front_left + h, front_left, front_right, ends);
  quad(back_left + h, back_right + h, back_right, back_left, ends);
  quad(front_left + h, back_left + h, back_left, front_left, sides);
  quad(back_right + h, front_right + h, front_right, back_right, sides);
  quad(back_left + h, front_left + h, front_right + h, back_right + h, top);
}

void Mesh::prism(const Vec3& centre_bottom, int n, double radius_bottom, double radius_top, double height,
                 const Cover& side, const Cover& cap) {
  const auto corner = [&](int i, double r, double z) {
    const double a = 2 * std::numbers::pi * i / n;
    return Vec3(centre_bottom + Vec3(r * std::cos(a), r * std::sin(a), z));
  };
  for (int i = 0; i < n; ++i) {
    // Seen from outside the next corner, counter-clockwise from above, is on the right.
    quad(corner(i, radius_top, height), corner(i + 1, radius_top, height), corner(i + 1, radius_bottom, 0),
         corner(i, radius_bottom, 0), side);
    triangle(centre_bottom + Vec3(0, 0, height), corner(i, radius_top, height), corner(i + 1, radius_top, height), cap);
  }
}

void Mesh::blob(const Vec3& centre, double radius_across, double radius_up, double crumple, const Cover& cover,
                Rng* rng) {
  // Icosahedron, each face split in four.
  const double g = std::numbers::phi;
  std::vector<Vec3> corner = {{-1, g, 0},  {1, g, 0},  {-1, -g, 0}, {1, -g, 0}, {0, -1, g},  {0, 1, g},
                              {0, -1, -g}, {0, 1, -g}, {g, 0, -1},  {g, 0, 1},  {-g, 0, -1}, {-g, 0, 1}};
  constexpr std::array<std::array<int, 3>, 20> kFaces = {{{0, 11, 5}, {0, 5, 1},  {0, 1, 7},   {0, 7, 10}, {0, 10, 11},
                                                          {1, 5, 9},  {5, 11, 4}, {11, 10, 2}, {10, 7, 6}, {7, 1, 8},
                                                          {3, 9, 4},  {3, 4, 2},  {3, 2, 6},   {3, 6, 8},  {3, 8, 9},
                                                          {4, 9, 5},  {2, 4, 11}, {6, 2, 10},  {8, 6, 7},  {9, 8, 1}}};
  const std::uint64_t salt = rng->bits();
  const auto place = [&](const Vec3& on_sphere) {
    const Vec3 d = on_sphere.normalized();
    // Crumple by direction, so that faces that share a corner agree.
    const auto key = [](double v) { return static_cast<std::uint64_t>(std::llround(v * 1000) + 5000); };
    const double k = 1 + crumple * (2 * Rng(salt, key(d.x()) + (key(d.y()) << 16) + (key(d.z()) << 32)).uniform() - 1);
    return Vec3(centre + k * Vec3(d.x() * radius_across, d.y() * radius_across, d.z() * radius_up));
  };
  // Leaves are laid on from the six sides: few materials a tree, so that a pixel's neighbours are shaded together.
  const std::uint32_t first_surface = static_cast<std::uint32_t>(surfaces.size());
  for (int side = 0; side < 6; ++side) {
    const int axis = side / 2;
    const Vec3 normal = (side % 2 == 0 ? 1.0 : -1.0) * Vec3::Unit(axis);
    Cover shifted = cover;
    shifted.u0 = rng->uniform(0, 256);
    shifted.v0 = rng->uniform(0, 256);
    surfaces.push_back(lay(shifted, centre, Vec3::Unit((axis + 1) % 3), Vec3::Unit((axis + 2) % 3), normal));
  }
  for (const auto& f : kFaces) {
    const Vec3 a = corner[f[0]].normalized(), b = corner[f[1]].normalized(), c = corner[f[2]].normalized();
    const Vec3 ab = (a + b).normalized(), bc = (b + c).normalized(), ca = (c + a).normalized();
    for (const auto& t : {std::array<Vec3, 3>{a, ab, ca}, {ab, b, bc}, {ca, bc, c}, {ab, bc, ca}}) {
      std::array<Vec3, 3> p = {place(t[0]), place(t[1]), place(t[2])};
      Vec3 normal = (p[1] - p[0]).cross(p[2] - p[0]);
      if (normal.dot(p[0] - centre) < 0) {  // face outwards
        std::swap(p[1], p[2]);
        normal = -normal;
      }
      int axis = 0;
      normal.cwiseAbs().maxCoeff(&axis);
      const std::uint32_t first = static_cast<std::uint32_t>(vertices.size());
      for (const Vec3& q : p) vertices.push_back(q.cast<float>());
      triangles.push_back(
          {{first, first + 1, first + 2}, first_surface + static_cast<std::uint32_t>(2 * axis + (normal[axis] < 0))});
    }
  }
}

void Mesh::gable_roof(const Vec3& centre_eaves, double dx, double dy, double half_along, double half_across,
                      double height, const Cover& slope, const Cover& gable) {
  const Vec3 l = half_along * Vec3(dx, dy, 0), w = half_across * Vec3(-dy, dx, 0), h(0, 0, height);
  const Vec3 front = centre_eaves + l, back = centre_eaves - l;
  const double overhang = 0.35, k = 1 + overhang / half_across, drop = -height * overhang / half_across;
  const Vec3 lo = l * (1 + overhang / half_along), d(0, 0, drop);
  const Vec3 ridge_front = centre_eaves + lo + h, ridge_back = centre_eaves - lo + h;
  quad(ridge_front, ridge_back, centre_eaves - lo + k * w + d, centre_eaves + lo + k * w + d, slope);
  quad(ridge_back, ridge_front, centre_eaves + lo - k * w + d, centre_eaves - lo - k * w + d, slope);
  triangle(front - w, front + w, front + h, gable);
  triangle(back + w, back - w, back + h, gable);
}

}  // namespace godwit::sim
