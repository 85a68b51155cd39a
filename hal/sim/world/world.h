// The simulated world: ground, still things, movers, light. Made from a plan and a seed; then immutable.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "hal/sim/world/mesh.h"
#include "hal/sim/world/terrain.h"
#include "hal/sim/world/texture.h"

namespace godwit::sim {

enum class WorldKind : std::uint8_t { kResidential, kFields, kSnow, kPlaza, kHighway, kAirfield, kCorridor };

struct WorldPlan {
  WorldKind kind = WorldKind::kResidential;
  double relief_m = 4;
  int cars = 40;                                         ///< that drive
  int people = 60;                                       ///< that walk
  double trees = 1;                                      ///< density, 1 = as the layout has it
  double sun_elevation_deg = 50, sun_azimuth_deg = 130;  ///< azimuth as headings count
  double ambient = 0.35;                                 ///< share of the sky in the light on flat ground
  bool night = false;                                    ///< street lamps instead of the sun
  double haze_m = 900;                                   ///< distance at which half of a thing's contrast is gone
  int ground_texels = 4096;                              ///< a side of the ground's picture; a power of two from 512
};

enum class MoverKind : std::uint8_t { kPerson, kCar, kTruck };

/// Parts of a mover that swing about a joint: arms and legs.
struct MoverPart {
  std::uint32_t first_vertex = 0, vertices = 0;
  Vec3f joint = Vec3f::Zero();
  float swing_rad = 0;  ///< amplitude about the mover's left axis; the sign sets the phase
};

/// Frame of a mover: x ahead, y left, z up, origin on the ground below its middle.
struct MoverModel {
  Mesh mesh;
  std::vector<MoverPart> parts;
  double radius_m = 0;  ///< of a sphere around (0, 0, height / 2)
  double height_m = 0;
  double half_length_m = 0, half_width_m = 0;  ///< of its shadow
};

/// A thing that can move, its way and its model.
struct Mover {
  MoverKind kind = MoverKind::kPerson;
  int model = 0;
  bool moving = true;                                        ///< false: parked, or standing
  Vec2 start_m = Vec2::Zero(), velocity_m_s = Vec2::Zero();  ///< straight part of the way
  Vec2 wander_m = Vec2::Zero();                              ///< amplitude of a wandering around it
  double wander_rad_s = 0, phase = 0, heading = 0;           ///< heading counts where it stands still
  double albedo = 1;
};

struct MoverState {
  Vec3 position_m, velocity_m_s;  ///< world
  Mat3 R_world_mover;
  double stride_phase;  ///< of the swinging parts
};

/// Something still: a run of the mesh with a sphere around it.
struct StaticObject {
  std::uint32_t first_triangle, triangles, first_surface, surfaces;
  Vec3f centre;
  float radius;
};

class World {
 public:
  World(const WorldPlan& plan, std::uint64_t seed);

  const WorldPlan& plan() const { return plan_; }
  const Terrain& terrain() const { return terrain_; }
  const std::vector<Texture>& textures() const { return textures_; }
  const Mesh& mesh() const { return mesh_; }
  const std::vector<StaticObject>& objects() const { return objects_; }
  const std::vector<MoverModel>& models() const { return models_; }
  const std::vector<Mover>& movers() const { return movers_; }

  /// Where mover i is at t_s; its position is that of the copy of the world in which it started, for the renderer to
  /// shift by whole periods. No allocation.
  MoverState mover_at(int i, double t_s) const;
  /// Light on a face with this normal at this place, relative to flat ground in the sun (by day) or under a lamp.
  double irradiance(const Vec3& normal, const Vec3& at) const;
  const Vec3& sun() const { return sun_; }
  /// Height of the highest still thing at a place, the ground included; what a rangefinder looking down meets.
  double surface_height(double x, double y) const;
  /// Whether the way from one place to another [m, world] goes through a face of a still thing.
  bool way_is_barred(const Vec3& from, const Vec3& to) const;

 private:
  friend class Layout;
  double lamp_light(double x, double y) const;
  void light_ground(Canvas* ground) const;
  void index_shades();

  WorldPlan plan_;
  std::uint64_t seed_;
  Terrain terrain_;
  Vec3 sun_;
  std::vector<Texture> textures_;
  Mesh mesh_;
  std::vector<StaticObject> objects_;
  std::vector<MoverModel> models_;
  std::vector<Mover> movers_;
  /// Things that throw a shadow: boxes (half extents along and across a heading) from the ground up, and crowns.
  struct Shade {
    double x, y, dx, dy, half_along, half_across, bottom, top;
    bool round;
  };
  std::vector<Shade> shades_;
  /// For each cell of a grid over the world the shades that reach into it, so that a look below asks few of them.
  std::vector<std::vector<std::uint32_t>> shades_of_cell_;
  std::vector<Vec2> lamps_;
};

}  // namespace godwit::sim
