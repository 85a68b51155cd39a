#include "hal/sim/world/layout.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace godwit::sim {
namespace {
constexpr double kPi = std::numbers::pi;
}  // namespace

Layout::Layout(World* world, Canvas* ground) : world_(*world), ground_(*ground), rng_(world->seed_, 0x1a40) {}

void Layout::build() {
  make_models();
  switch (world_.plan_.kind) {
    case WorldKind::kResidential:
      residential();
      break;
    case WorldKind::kFields:
      fields(false);
      break;
    case WorldKind::kSnow:
      fields(true);
      break;
    case WorldKind::kPlaza:
      plaza();
      break;
    case WorldKind::kHighway:
      highway();
      break;
    case WorldKind::kAirfield:
      airfield();
      break;
    case WorldKind::kCorridor:
      corridor();
      break;
  }
}

void Layout::paint(double x, double y, double dx, double dy, double half_along, double half_across, double brightness,
                   double grain) {
  const double k = ground_.size() / kWorldM;
  ground_.rect(x * k, y * k, dx, dy, half_along * k, half_across * k, brightness, grain);
}

void Layout::spot(double x, double y, double radius, double brightness, double grain) {
  const double k = ground_.size() / kWorldM;
  ground_.disc(x * k, y * k, radius * k, brightness, grain);
}

void Layout::shade_box(double x, double y, double dx, double dy, double half_along, double half_across, double top) {
  world_.shades_.push_back({x, y, dx, dy, half_along, half_across, 0, top, false});
}

void Layout::house(double x, double y, bool along_x) {
  const double dx = along_x ? 1 : 0, dy = along_x ? 0 : 1;
  const double half_along = rng_.uniform(4.5, 6.5), half_across = rng_.uniform(3.6, 4.8),
               eaves = rng_.uniform(2.9, 5.8);
  const double rise = rng_.uniform(1.8, 3.2);
  double z = 1e9;
  for (const double a : {-1.0, 1.0}) {
    for (const double b : {-1.0, 1.0}) z = std::min(z, world_.terrain_.height(x + a * 6, y + b * 6));
  }
  const int facade = kTexFacade0 + rng_.below(4), roof = kTexRoof0 + rng_.below(2);
  const double paint_factor = rng_.uniform(0.75, 1.1), roof_factor = rng_.uniform(0.7, 1.5);
  const Cover wall{facade, kFacadeTexelsPerM, paint_factor, rng_.uniform(0, 512), 10, false};
  const Cover slope{roof, kRoofTexelsPerM, roof_factor, rng_.uniform(0, 256), 0, false};
  const Cover plain_wall{kTexConcrete, kConcreteTexelsPerM, paint_factor, 0, 0, false};
  object([&](Mesh* m) {
    m->box(Vec3(x, y, z - 0.3), dx, dy, half_along, half_across, eaves + 0.3, wall, wall, slope);
    m->gable_roof(Vec3(x, y, z + eaves), dx, dy, half_along, half_across, rise, slope, plain_wall);
    const double s = rng_.uniform(-0.6, 0.6) * half_along;
    m->box(Vec3(x + s * dx - 1.0 * dy, y + s * dy + 1.0 * dx, z + eaves + rise * 0.4), dx, dy, 0.4, 0.4,
           rise * 0.6 + 0.9, kConcrete, kConcrete, {kTexConcrete, kConcreteTexelsPerM, 0.3, 0, 0, false});
    if (rng_.chance(0.5)) {  // a skylight or a solar panel, just above the slope
      const double w = half_across * 0.5, up = rise * 0.5 + 0.06, a = rng_.uniform(-0.5, 0.2) * half_along;
      const Vec3 l(dx, dy, 0), n(-dy, dx, 0), c = Vec3(x, y, z + eaves + up) + a * l + w * n;
      const Vec3 down = (half_across * n - Vec3(0, 0, rise)).normalized();
      const double long_side = rng_.uniform(0.6, 2.2);
      m->quad(c + long_side * l - 0.6 * down, c - long_side * l - 0.6 * down, c - long_side * l + 0.8 * down,
              c + long_side * l + 0.8 * down, {kTexGlass, 0, 1, 0, 0, false});
    }
  });
  shade_box(x, y, dx, dy, half_along + 0.3, half_across + 0.3, eaves);
  shade_box(x, y, dx, dy, half_along, half_across * 0.4, eaves + rise * 0.8);
}

void Layout::block(double x, double y, double half_x, double half_y, double height, int facade) {
  const double z = world_.terrain_.height(x, y) - 0.5;
  const Cover wall{kTexFacade0 + facade, kFacadeTexelsPerM, rng_.uniform(0.8, 1.1), rng_.uniform(0, 512), 0, false};
  object([&](Mesh* m) {
    m->box(Vec3(x, y, z), 1, 0, half_x, half_y, height + 0.5, wall, wall, kConcrete);
    for (int i = 0; i < 5; ++i) {  // plant on the roof
      m->box(Vec3(x + rng_.uniform(-0.7, 0.7) * half_x, y + rng_.uniform(-0.7, 0.7) * half_y, z + height + 0.5), 1, 0,
             rng_.uniform(0.5, 2), rng_.uniform(0.5, 2), rng_.uniform(0.6, 2.2), kConcrete, kConcrete,
             {kTexConcrete, kConcreteTexelsPerM, rng_.uniform(0.4, 1.3), 0, 0, false});
    }
  });
  shade_box(x, y, 1, 0, half_x, half_y, height);
}

void Layout::tree(double x, double y, double size) {
  const double z = world_.terrain_.height(x, y);
  const int leaf = kTexFoliage0 + rng_.below(2);
  const Cover crown{leaf, kFoliageTexelsPerM, rng_.uniform(0.8, 1.25), 0, 0, false};
  const Cover trunk{kTexBark, 64, 1, 0, 0, false};
  object([&](Mesh* m) {
    m->prism(Vec3(x, y, z - 0.2), 6, 0.09 * size, 0.06 * size, 1.4 * size, trunk, trunk);
    m->blob(Vec3(x, y, z + 1.9 * size), 0.95 * size, 0.9 * size, 0.16, crown, &rng_);
    for (int i = 0; i < 2; ++i) {
      const double a = rng_.uniform(0, 2 * kPi);
      m->blob(Vec3(x + 0.55 * size * std::cos(a), y + 0.55 * size * std::sin(a), z + rng_.uniform(1.4, 2.4) * size),
              0.6 * size, 0.55 * size, 0.18, crown, &rng_);
    }
  });
  world_.shades_.push_back({x, y, 1, 0, 1.1 * size, 1.1 * size, 1.1 * size, 2.7 * size, true});
}

void Layout::bush(double x, double y, double radius) {
  const double z = world_.terrain_.height(x, y);
  const Cover crown{kTexFoliage0 + rng_.below(2), kFoliageTexelsPerM, rng_.uniform(0.7, 1.2), 0, 0, false};
  object([&](Mesh* m) { m->blob(Vec3(x, y, z + 0.4 * radius), radius, 0.8 * radius, 0.2, crown, &rng_); });
  world_.shades_.push_back({x, y, 1, 0, radius, radius, 0, 1.2 * radius, true});
}

void Layout::hedge(double x, double y, bool along_x, double half_length) {
  const double z = world_.terrain_.height(x, y);
  const Cover leaf{kTexFoliage0, kFoliageTexelsPerM, rng_.uniform(0.8, 1.2), rng_.uniform(0, 256), 0, false};
  const double height = rng_.uniform(0.9, 1.7);
  object([&](Mesh* m) {
    m->box(Vec3(x, y, z - 0.5), along_x ? 1 : 0, along_x ? 0 : 1, half_length, 0.4, height + 0.5, leaf, leaf, leaf);
  });
  shade_box(x, y, along_x ? 1 : 0, along_x ? 0 : 1, half_length, 0.4, height);
}

void Layout::lamp(double x, double y) {
  const double z = world_.terrain_.height(x, y);
  const Cover pole{kTexConcrete, kConcreteTexelsPerM, 0.5, 0, 0, false};
  Cover head{kTexSkin, 0, 1.6, 0, 0, world_.plan_.night};
  object([&](Mesh* m) {
    m->prism(Vec3(x, y, z - 0.2), 5, 0.09, 0.06, 6.2, pole, pole);
    m->prism(Vec3(x, y, z + 6.0), 6, 0.18, 0.32, 0.35, head, head);
  });
  shade_box(x, y, 1, 0, 0.08, 0.08, 6);
  world_.lamps_.emplace_back(x, y);
}

void Layout::crate(double x, double y, double heading, double half_along, double half_across, double height,
                   int texture, double albedo) {
  const double z = world_.terrain_.height(x, y), dx = std::cos(heading), dy = std::sin(heading);
  const Cover cover{texture, texture == kTexConcrete ? kConcreteTexelsPerM : 0, albedo, 0, 0, false};
  const Cover top{kTexConcrete, kConcreteTexelsPerM, albedo, rng_.uniform(0, 256), 0, false};
  object(
      [&](Mesh* m) { m->box(Vec3(x, y, z - 0.2), dx, dy, half_along, half_across, height + 0.2, cover, cover, top); });
  shade_box(x, y, dx, dy, half_along, half_across, height);
}

void Layout::wear(double x0, double y0, double x1, double y1, int marks) {
  for (int i = 0; i < marks; ++i) {
    const double x = rng_.uniform(x0, x1), y = rng_.uniform(y0, y1), kind = rng_.uniform();
    if (kind < 0.35) {  // a patch of newer or older surface
      paint(x, y, 1, 0, rng_.uniform(0.3, 2.5), rng_.uniform(0.2, 1.2), rng_.chance(0.6) ? 52 : 105, 70);
    } else if (kind < 0.55) {  // manhole
      spot(x, y, 0.38, 130, 60);
      spot(x, y, 0.30, 42, 80);
    } else if (kind < 0.8) {  // crack filled with tar
      const double a = rng_.uniform(0, kPi);
      double px = x, py = y;
      for (int k = 0; k < 5; ++k) {
        const double b = a + rng_.uniform(-0.6, 0.6);
        paint(px, py, std::cos(b), std::sin(b), 0.5, 0.06, 38, 40);
        px += 0.9 * std::cos(b);
        py += 0.9 * std::sin(b);
      }
    } else {
      spot(x, y, rng_.uniform(0.15, 0.6), 55, 50);  // oil
    }
  }
}

void Layout::road_x(double y, double half_width, int lanes) {
  const double middle = kWorldM / 2;
  paint(middle, y, 1, 0, middle, half_width + 2.0, 148, 45);  // pavement
  for (double x = 0; x < kWorldM; x += 1.6) {
    paint(x, y + half_width + 1.0, 0, 1, 1.0, 0.05, 105, 40);
    paint(x, y - half_width - 1.0, 0, 1, 1.0, 0.05, 105, 40);
  }
  paint(middle, y, 1, 0, middle, half_width + 0.15, 185, 30);  // kerb
  paint(middle, y, 1, 0, middle, half_width, 78, 62);
  wear(0, y - half_width + 0.5, kWorldM, y + half_width - 0.5, static_cast<int>(kWorldM * half_width / 14));
  for (int lane = 1; lane < lanes; ++lane) {
    const double at = y - half_width + 2 * half_width * lane / lanes;
    for (double x = 1.5; x < kWorldM; x += 6.4) paint(x, at, 1, 0, 1.4, 0.08, 225, 40);
  }
}

void Layout::road_y(double x, double half_width) {
  const double middle = kWorldM / 2;
  paint(x, middle, 0, 1, middle, half_width + 2.0, 148, 45);
  paint(x, middle, 0, 1, middle, half_width + 0.15, 185, 30);
  paint(x, middle, 0, 1, middle, half_width, 80, 62);
  wear(x - half_width + 0.5, 0, x + half_width - 0.5, kWorldM, static_cast<int>(kWorldM * half_width / 14));
  for (double y = 1.5; y < kWorldM; y += 6.4) paint(x, y, 0, 1, 1.4, 0.08, 225, 40);
}

}  // namespace godwit::sim
