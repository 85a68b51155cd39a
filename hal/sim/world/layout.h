// Lays out a world of one kind: paints its ground, puts up what stands, and sends out what moves.
#pragma once

#include "hal/sim/world/world.h"

namespace godwit::sim {

inline const Cover kConcrete{kTexConcrete, kConcreteTexelsPerM, 1, 0, 0, false};

/// Works on a world under construction. One use.
class Layout {
 public:
  Layout(World* world, Canvas* ground);
  void build();

 private:
  // Kinds of world.
  void residential();
  void fields(bool snow);
  void plaza();
  void highway();
  void airfield();
  void corridor();

  // Ground, in metres.
  void paint(double x, double y, double dx, double dy, double half_along, double half_across, double brightness,
             double grain);
  void spot(double x, double y, double radius, double brightness, double grain);
  void road_x(double y, double half_width, int lanes);
  void road_y(double x, double half_width);
  void wear(double x0, double y0, double x1, double y1, int marks);

  // Things.
  template <typename Make>
  void object(Make make) {
    Mesh& mesh = world_.mesh_;
    const std::uint32_t t0 = static_cast<std::uint32_t>(mesh.triangles.size()),
                        v0 = static_cast<std::uint32_t>(mesh.vertices.size()),
                        s0 = static_cast<std::uint32_t>(mesh.surfaces.size());
    make(&mesh);
    StaticObject o{t0,
                   static_cast<std::uint32_t>(mesh.triangles.size()) - t0,
                   s0,
                   static_cast<std::uint32_t>(mesh.surfaces.size()) - s0,
                   Vec3f::Zero(),
                   0};
    Vec3f low = mesh.vertices[v0], high = low;
    for (std::size_t i = v0; i < mesh.vertices.size(); ++i) {
      low = low.cwiseMin(mesh.vertices[i]);
      high = high.cwiseMax(mesh.vertices[i]);
    }
    o.centre = 0.5f * (low + high);
    o.radius = 0.5f * (high - low).norm();
    world_.objects_.push_back(o);
  }
  void house(double x, double y, bool along_x);
  void block(double x, double y, double half_x, double half_y, double height, int facade);
  void tree(double x, double y, double size);
  void bush(double x, double y, double radius);
  void hedge(double x, double y, bool along_x, double half_length);
  void lamp(double x, double y);
  void crate(double x, double y, double heading, double half_along, double half_across, double height, int texture,
             double albedo);
  void shade_box(double x, double y, double dx, double dy, double half_along, double half_across, double top);

  // Movers.
  void make_models();
  void car(double x, double y, double heading, double speed, bool parked);
  void truck(double x, double y, double heading, double speed);
  void walker(double x, double y, double heading, double speed);
  void wanderer(double x, double y, double reach);

  World& world_;
  Canvas& ground_;
  Rng rng_;
  int cars_ = 0, trucks_ = 0, people_ = 0;  ///< number of models of each kind
};

}  // namespace godwit::sim
