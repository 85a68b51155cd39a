#include "hal/sim/world/world.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "hal/sim/world/layout.h"

namespace godwit::sim {
namespace {
constexpr double kRadPerDeg = std::numbers::pi / 180.0;
constexpr double kNightAmbient = 0.05;
constexpr int kShadeCells = 64;   // a side; a power of two
constexpr int kLightCells = 512;  // the slowly varying part of the light on the ground is worked out on this grid

double wrapped(double d) {
  return d - kWorldM * std::round(d / kWorldM);
}
}  // namespace

World::World(const WorldPlan& plan, std::uint64_t seed)
    : plan_(plan), seed_(seed), terrain_(plan.kind == WorldKind::kCorridor ? 0.0 : plan.relief_m, mix(seed, 0x7e44)) {
  const double e = plan.sun_elevation_deg * kRadPerDeg, a = plan.sun_azimuth_deg * kRadPerDeg;
  sun_ = Vec3(std::cos(e) * std::cos(a), std::cos(e) * std::sin(a), std::sin(e));
  Canvas ground(plan.ground_texels);
  Layout(this, &ground).build();
  index_shades();
  light_ground(&ground);
  textures_ = make_materials(mix(seed, 0x7e87), ground, plan.night);
  for (const StaticObject& o : objects_) {
    for (std::uint32_t i = 0; i < o.surfaces; ++i) {
      Surface& s = mesh_.surfaces[o.first_surface + i];
      s.light = s.emits ? 1.0f : static_cast<float>(irradiance(s.normal.cast<double>(), s.origin.cast<double>()));
    }
  }
}

double World::lamp_light(double x, double y) const {
  double sum = kNightAmbient;
  for (const Vec2& lamp : lamps_) {
    const double dx = wrapped(x - lamp.x()), dy = wrapped(y - lamp.y()), d2 = (dx * dx + dy * dy) / 36.0;
    if (d2 < 60) sum += 0.9 / ((1 + d2) * (1 + d2));
  }
  return std::min(sum, 1.2);
}

double World::irradiance(const Vec3& normal, const Vec3& at) const {
  if (plan_.kind == WorldKind::kCorridor) return 0.85 + 0.15 * normal.z();
  if (plan_.night) return lamp_light(at.x(), at.y()) * (0.7 + 0.3 * normal.z());
  const double flat = plan_.ambient + (1 - plan_.ambient) * 1.0;
  const double direct = std::max(0.0, normal.dot(sun_)) / std::max(0.2, sun_.z());
  return (plan_.ambient * (0.65 + 0.35 * normal.z()) + (1 - plan_.ambient) * std::min(direct, 2.5)) / flat;
}

void World::light_ground(Canvas* ground) const {
  // Grain first: noise of all sizes, stronger where the material is rough; then light over it.
  ground->noise(std::array{512, 128, 32}, 0.10, mix(seed_, 0x901), true);
  ground->noise(std::array{8, 4, 2, 1}, 0.17, mix(seed_, 0x902), true);
  if (plan_.kind == WorldKind::kCorridor) return;

  const int n = ground->size();
  const double texel = kWorldM / n;
  std::vector<float> grid(kLightCells * kLightCells);
  const double step = kWorldM / kLightCells;
  for (int j = 0; j < kLightCells; ++j) {
    for (int i = 0; i < kLightCells; ++i) {
      const double x = i * step, y = j * step;
      const Vec3 normal = terrain_.normal(x, y);
      grid[j * kLightCells + i] = static_cast<float>(irradiance(normal, Vec3(x, y, 0)));
    }
  }
  std::vector<std::uint8_t> shadow(n * n, 0);
  if (!plan_.night && sun_.z() > 0.02) {
    const Vec2 cast(-sun_.x() / sun_.z(), -sun_.y() / sun_.z());  // shadow's shift a metre of height
    for (const Shade& s : shades_) {
      // A point lies in shadow if some height h in [bottom, top] of the thing stands over p - h * cast.
      const double longest = std::min(s.top, 60.0 / std::max(0.1, cast.norm()));
      const double radius = std::max(s.half_along, s.half_across) * 1.5;
      const Vec2 a = Vec2(s.x, s.y) + s.bottom * cast, b = Vec2(s.x, s.y) + longest * cast;
      const int x0 = static_cast<int>((std::min(a.x(), b.x()) - radius) / texel) - 1;
      const int x1 = static_cast<int>((std::max(a.x(), b.x()) + radius) / texel) + 1;
      const int y0 = static_cast<int>((std::min(a.y(), b.y()) - radius) / texel) - 1;
      const int y1 = static_cast<int>((std::max(a.y(), b.y()) + radius) / texel) + 1;
      for (int ty = y0; ty <= y1; ++ty) {
        for (int tx = x0; tx <= x1; ++tx) {
          const Vec2 p((tx + 0.5) * texel - s.x, (ty + 0.5) * texel - s.y);
          bool in = false;
          if (s.round) {
            const Vec2 q = p - 0.5 * (s.bottom + longest) * cast;
            // The shadow of an ellipsoid is stretched along the light.
            const double stretch = std::hypot(1.0, 0.5 * (s.top - s.bottom) / s.half_along * cast.norm());
            const Vec2 u = cast.norm() > 1e-9 ? Vec2(cast.normalized()) : Vec2(1, 0);
            const double along = q.dot(u) / (s.half_along * stretch),
                         across = (-q.x() * u.y() + q.y() * u.x()) / s.half_along;
            in = along * along + across * across < 1;
          } else {
            double low = s.bottom, high = longest;
            for (const auto& [axis, half] :
                 {std::pair{Vec2(s.dx, s.dy), s.half_along}, {Vec2(-s.dy, s.dx), s.half_across}}) {
              const double at = p.dot(axis), rate = cast.dot(axis);
              if (std::abs(rate) < 1e-9) {
                if (std::abs(at) > half) high = -1;
                continue;
              }
              const double h0 = (at - half) / rate, h1 = (at + half) / rate;
              low = std::max(low, std::min(h0, h1));
              high = std::min(high, std::max(h0, h1));
            }
            in = low <= high;
          }
          if (in) shadow[(ty & (n - 1)) * n + (tx & (n - 1))] = 1;
        }
      }
    }
  }
  const float dark = static_cast<float>(plan_.ambient * 0.9);
  const int run = n / kLightCells;  // texels a cell
  std::vector<float> light(n);
  for (int y = 0; y < n; ++y) {
    const int j = y / run;
    const float v = (static_cast<float>(y % run) + 0.5f) / static_cast<float>(run);
    const auto row = [&](int k) { return &grid[(k % kLightCells) * kLightCells]; };
    const float *r0 = row(j), *r1 = row(j + 1);
    const std::uint8_t* shaded = &shadow[y * n];
    for (int i = 0; i < kLightCells; ++i) {
      const int i1 = (i + 1) % kLightCells;
      const float a = r0[i] + v * (r1[i] - r0[i]), b = r0[i1] + v * (r1[i1] - r0[i1]);
      for (int k = 0; k < run; ++k) {
        const float value = a + (static_cast<float>(k) + 0.5f) / static_cast<float>(run) * (b - a);
        light[i * run + k] = shaded[i * run + k] != 0 ? value * dark : value;
      }
    }
    ground->scale_row(y, light);
  }
}

MoverState World::mover_at(int i, double t_s) const {
  const Mover& m = movers_[i];
  MoverState out;
  Vec2 p = m.start_m, v = Vec2::Zero();
  double heading = m.heading;
  if (m.moving) {
    const double w = m.wander_rad_s, a = w * t_s + m.phase, b = 0.618 * w * t_s + 2.3 * m.phase;
    p += t_s * m.velocity_m_s + Vec2(m.wander_m.x() * std::sin(a), m.wander_m.y() * std::sin(b));
    v = m.velocity_m_s + Vec2(m.wander_m.x() * w * std::cos(a), m.wander_m.y() * 0.618 * w * std::cos(b));
    if (v.norm() > 1e-3) heading = std::atan2(v.y(), v.x());
  }
  const double z = terrain_.height(p.x(), p.y());
  // Longer than a person: lies along the slope between its axles.
  const Vec2 ahead(std::cos(heading), std::sin(heading));
  const double base = m.kind == MoverKind::kPerson ? 0.0 : 1.4;
  double pitch = 0, lift = z, climb = 0;
  if (base > 0) {
    const Vec2 f = p + base * ahead, r = p - base * ahead;
    const double zf = terrain_.height(f.x(), f.y()), zr = terrain_.height(r.x(), r.y());
    pitch = std::atan2(zf - zr, 2 * base);
    lift = 0.5 * (zf + zr);
    climb = v.norm() * (zf - zr) / (2 * base);
  }
  out.position_m = Vec3(p.x(), p.y(), lift);
  out.velocity_m_s = Vec3(v.x(), v.y(), climb);
  out.R_world_mover =
      (Eigen::AngleAxisd(heading, Vec3::UnitZ()) * Eigen::AngleAxisd(-pitch, Vec3::UnitY())).toRotationMatrix();
  // One stride (two steps) is about 1.5 m long; a wanderer keeps the rhythm of its mean speed.
  const double pace = m.velocity_m_s.norm() + 0.6 * m.wander_m.norm() * m.wander_rad_s;
  out.stride_phase = m.moving ? m.phase + 2 * std::numbers::pi / 1.5 * pace * t_s : 0.0;
  return out;
}

void World::index_shades() {
  shades_of_cell_.resize(kShadeCells * kShadeCells);
  constexpr double cell = kWorldM / kShadeCells;
  for (std::size_t n = 0; n < shades_.size(); ++n) {
    const Shade& s = shades_[n];
    const double rx = s.round ? s.half_along : std::abs(s.dx) * s.half_along + std::abs(s.dy) * s.half_across;
    const double ry = s.round ? s.half_along : std::abs(s.dy) * s.half_along + std::abs(s.dx) * s.half_across;
    const auto at = [](double v) { return static_cast<int>(std::floor(v / cell)); };
    // Whole turns around the world would name a cell twice.
    const int i1 = std::min(at(s.x + rx), at(s.x - rx) + kShadeCells - 1);
    const int j1 = std::min(at(s.y + ry), at(s.y - ry) + kShadeCells - 1);
    for (int j = at(s.y - ry); j <= j1; ++j) {
      for (int i = at(s.x - rx); i <= i1; ++i) {
        const int k = (j & (kShadeCells - 1)) * kShadeCells + (i & (kShadeCells - 1));
        shades_of_cell_[k].push_back(static_cast<std::uint32_t>(n));
      }
    }
  }
}

double World::surface_height(double x, double y) const {
  const double ground = terrain_.height(x, y);
  double top = ground;
  const auto cell = [](double v) {
    return static_cast<int>(std::floor(v * (kShadeCells / kWorldM))) & (kShadeCells - 1);
  };
  for (const std::uint32_t n : shades_of_cell_[cell(y) * kShadeCells + cell(x)]) {
    const Shade& s = shades_[n];
    const double px = wrapped(x - s.x), py = wrapped(y - s.y);
    const double along = std::abs(px * s.dx + py * s.dy), across = std::abs(-px * s.dy + py * s.dx);
    const bool in =
        s.round ? px * px + py * py < s.half_along * s.half_along : along < s.half_along && across < s.half_across;
    if (in) top = std::max(top, ground + s.top);
  }
  return top;
}

bool World::way_is_barred(const Vec3& from, const Vec3& to) const {
  const Vec3 way = to - from;
  for (const StaticObject& object : objects_) {
    // The world is periodic: the copy of the thing that is nearest.
    Vec3 shift = from - object.centre.cast<double>();
    shift = Vec3(shift.x() - wrapped(shift.x()), shift.y() - wrapped(shift.y()), 0);
    const Vec3 a = from - shift;
    if ((a - object.centre.cast<double>()).norm() > object.radius + way.norm()) continue;
    for (std::uint32_t i = object.first_triangle; i < object.first_triangle + object.triangles; ++i) {
      const MeshTriangle& triangle = mesh_.triangles[i];
      const Vec3 p = mesh_.vertices[triangle.vertex[0]].cast<double>();
      const Vec3 u = mesh_.vertices[triangle.vertex[1]].cast<double>() - p;
      const Vec3 v = mesh_.vertices[triangle.vertex[2]].cast<double>() - p;
      // a + s way = p + x u + y v (Moeller and Trumbore 1997).
      const Vec3 across = way.cross(v);
      const double det = u.dot(across);
      if (std::abs(det) < 1e-12) continue;
      const Vec3 from_p = a - p;
      const double x = from_p.dot(across) / det;
      const double y = way.dot(from_p.cross(u)) / det;
      const double s = v.dot(from_p.cross(u)) / det;
      if (x >= 0 && y >= 0 && x + y <= 1 && s >= 0 && s <= 1) return true;
    }
  }
  return false;
}

}  // namespace godwit::sim
