// Models of people, cars and trucks, and the ways they take.
#include <cmath>
#include <numbers>

#include "hal/sim/world/layout.h"

namespace godwit::sim {
namespace {

/// Adds to a model's mesh and notes the vertices as one swinging part.
template <typename Make>
void part(MoverModel* model, const Vec3f& joint, double swing, Make make) {
  const std::uint32_t first = static_cast<std::uint32_t>(model->mesh.vertices.size());
  make(&model->mesh);
  const std::uint32_t count = static_cast<std::uint32_t>(model->mesh.vertices.size()) - first;
  model->parts.push_back({first, count, joint, static_cast<float>(swing)});
}

MoverModel person(Rng* rng, int coat) {
  MoverModel m;
  const double h = rng->uniform(1.62, 1.86) / 1.75;
  const Cover skin{kTexSkin, 0, 1, 0, 0, false}, hair{kTexBark, 64, rng->uniform(0.4, 1.6), 0, 0, false};
  const Cover cloth{coat, 128, rng->uniform(0.6, 1.25), rng->uniform(0, 128), 0, false};
  const Cover trousers{kTexCloth0, 128, rng->uniform(0.5, 1.8), rng->uniform(0, 128), 64, false};
  const auto side = [&](double s) { return s * h; };
  m.mesh.prism(Vec3(0, 0, side(0.82)), 8, side(0.17), side(0.21), side(0.62), cloth, cloth);
  m.mesh.prism(Vec3(0, 0, side(1.42)), 6, side(0.07), side(0.07), side(0.1), skin, skin);
  m.mesh.prism(Vec3(0, 0, side(1.50)), 8, side(0.09), side(0.11), side(0.16), skin, hair);
  m.mesh.prism(Vec3(0, 0, side(1.64)), 8, side(0.115), side(0.06), side(0.11), hair, hair);
  for (const double s : {1.0, -1.0}) {
    part(&m, Vec3(0, s * 0.1 * h, 0.86 * h).cast<float>(), s * 0.45, [&](Mesh* mesh) {
      mesh->prism(Vec3(0, side(s * 0.1), side(0.06)), 6, side(0.06), side(0.1), side(0.8), trousers, trousers);
      mesh->box(Vec3(side(0.06), side(s * 0.1), 0), 1, 0, side(0.14), side(0.05), side(0.08), hair, hair, hair);
    });
    part(&m, Vec3(0, s * 0.24 * h, 1.40 * h).cast<float>(), -s * 0.4, [&](Mesh* mesh) {
      mesh->prism(Vec3(0, side(s * 0.25), side(0.82)), 6, side(0.045), side(0.065), side(0.6), cloth, cloth);
      mesh->prism(Vec3(0, side(s * 0.25), side(0.72)), 6, side(0.04), side(0.04), side(0.1), skin, skin);
    });
  }
  m.height_m = 1.76 * h;
  m.half_length_m = m.half_width_m = 0.28;
  m.radius_m = 1.15 * h;
  return m;
}

MoverModel car_model(Rng* rng) {
  MoverModel m;
  const double l = rng->uniform(1.95, 2.3), w = rng->uniform(0.84, 0.92), body = rng->uniform(0.62, 0.8),
               cabin = rng->uniform(0.5, 0.65);
  const double paint = rng->uniform(0.25, 1.2);
  const Cover side{kTexCarSide, 0, paint, 0, 0, false}, end{kTexCarEnd, 0, paint, 0, 0, false},
      top{kTexCarTop, 0, paint, 0, 0, false}, glass{kTexGlass, 0, 1, 0, 0, false};
  m.mesh.box(Vec3(0, 0, 0.22), 1, 0, l, w, body - 0.22 + 0.2, end, side, top);
  // Cabin: slanted glass all around, painted roof.
  const double z0 = body + 0.2, z1 = z0 + cabin, f0 = 0.45 * l, b0 = -0.8 * l, f1 = 0.1 * l, b1 = -0.55 * l,
               w1 = 0.8 * w;
  const Vec3 fl0(f0, w, z0), fr0(f0, -w, z0), bl0(b0, w, z0), br0(b0, -w, z0);
  const Vec3 fl1(f1, w1, z1), fr1(f1, -w1, z1), bl1(b1, w1, z1), br1(b1, -w1, z1);
  m.mesh.quad(fr1, fl1, fl0, fr0, glass);
  m.mesh.quad(bl1, br1, br0, bl0, glass);
  m.mesh.quad(fl1, bl1, bl0, fl0, glass);
  m.mesh.quad(br1, fr1, fr0, br0, glass);
  m.mesh.quad(bl1, fl1, fr1, br1, {kTexCarTop, 0, paint, 0, 0, false});
  for (const double x : {0.62 * l, -0.6 * l}) {  // wheels stand out a little
    m.mesh.box(Vec3(x, 0, 0), 1, 0, 0.31, w + 0.02, 0.5, {kTexBark, 64, 0.3, 0, 0, false},
               {kTexBark, 64, 0.35, 0, 0, false}, {kTexBark, 64, 0.3, 0, 0, false});
  }
  m.height_m = z1;
  m.half_length_m = l;
  m.half_width_m = w;
  m.radius_m = std::sqrt(l * l + w * w + 1);
  return m;
}

MoverModel truck_model(Rng* rng, int livery) {
  MoverModel m;
  const Cover side{kTexTruckSide0 + livery, 0, rng->uniform(0.7, 1.1), 0, 0, false},
      top{kTexConcrete, 64, rng->uniform(0.7, 1.3), 0, 0, false}, end{kTexCarEnd, 0, 0.8, 0, 0, false},
      glass{kTexGlass, 0, 1, 0, 0, false}, cab{kTexCarSide, 0, rng->uniform(0.4, 1.1), 0, 0, false};
  m.mesh.box(Vec3(-1.2, 0, 0.35), 1, 0, 4.9, 1.25, 3.4, end, side, top);
  m.mesh.box(Vec3(4.95, 0, 0.3), 1, 0, 1.05, 1.2, 2.5, glass, cab, {kTexCarTop, 0, 0.9, 0, 0, false});
  for (const double x : {5.0, -3.4, -4.6})
    m.mesh.box(Vec3(x, 0, 0), 1, 0, 0.48, 1.27, 0.9, {kTexBark, 64, 0.3, 0, 0, false},
               {kTexBark, 64, 0.35, 0, 0, false}, {kTexBark, 64, 0.3, 0, 0, false});
  m.height_m = 3.75;
  m.half_length_m = 6.1;
  m.half_width_m = 1.27;
  m.radius_m = 6.7;
  return m;
}

}  // namespace

void Layout::make_models() {
  for (cars_ = 0; cars_ < 10; ++cars_) world_.models_.push_back(car_model(&rng_));
  for (trucks_ = 0; trucks_ < 4; ++trucks_) world_.models_.push_back(truck_model(&rng_, trucks_ % 2));
  for (people_ = 0; people_ < 12; ++people_) world_.models_.push_back(person(&rng_, kTexCloth0 + people_ % 3));
}

void Layout::car(double x, double y, double heading, double speed, bool parked) {
  Mover m;
  m.kind = MoverKind::kCar;
  m.model = rng_.below(cars_);
  m.moving = !parked;
  m.start_m = Vec2(x, y);
  m.velocity_m_s = speed * Vec2(std::cos(heading), std::sin(heading));
  m.heading = heading;
  m.albedo = rng_.uniform(0.5, 1.15);
  world_.movers_.push_back(m);
}

void Layout::truck(double x, double y, double heading, double speed) {
  Mover m;
  m.kind = MoverKind::kTruck;
  m.model = cars_ + rng_.below(trucks_);
  m.start_m = Vec2(x, y);
  m.velocity_m_s = speed * Vec2(std::cos(heading), std::sin(heading));
  m.heading = heading;
  m.albedo = rng_.uniform(0.7, 1.1);
  world_.movers_.push_back(m);
}

void Layout::walker(double x, double y, double heading, double speed) {
  Mover m;
  m.kind = MoverKind::kPerson;
  m.model = cars_ + trucks_ + rng_.below(people_);
  m.start_m = Vec2(x, y);
  m.velocity_m_s = speed * Vec2(std::cos(heading), std::sin(heading));
  m.heading = heading;
  m.phase = rng_.uniform(0, 2 * std::numbers::pi);
  m.albedo = rng_.uniform(0.7, 1.2);
  world_.movers_.push_back(m);
}

void Layout::wanderer(double x, double y, double reach) {
  walker(x, y, 0, 0);
  Mover& m = world_.movers_.back();
  m.wander_m = Vec2(reach, reach * rng_.uniform(0.6, 1.4));
  m.wander_rad_s = rng_.uniform(0.7, 1.3) * 1.1 / reach;
}

}  // namespace godwit::sim
