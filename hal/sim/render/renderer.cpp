// What is in sight: transforms, culling, sorting into tiles.
#include "hal/sim/render/renderer.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace godwit::sim {
namespace {
constexpr std::size_t kMaxTriangles = 120'000, kMaxNodes = 900'000, kMaxSurfaces = 60'000;
constexpr std::uint32_t kBackground = 0, kGround = 1, kFarGround = 2, kSky = 3;
constexpr double kGroundReachM = 166.4;  // fine relief around the camera; a coarse copy, a little lower, lies beyond
constexpr double kFarReachM = 1200, kObjectReachM = 260, kMoverReachM = 160;
constexpr double kSkyM = 700;
constexpr double kLeastRadiusPx = 1.2;

double nearest_copy(double from, double to) {
  return kWorldM * std::round((to - from) / kWorldM);
}
}  // namespace

CameraPose camera_pose(const Trajectory& trajectory, const CameraRig& rig, double t_s) {
  const BodyState body = trajectory.at(t_s);
  CameraPose out;
  out.R_world_cam = body.R_world_body * rig.R_body_cam;
  out.position_m = body.position_m + body.R_world_body * rig.t_body_cam_m;
  const Vec3 lever = body.omega_rad_s.cross(rig.t_body_cam_m);
  out.velocity_cam_m_s = out.R_world_cam.transpose() * body.velocity_m_s + rig.R_body_cam.transpose() * lever;
  out.omega_cam_rad_s = rig.R_body_cam.transpose() * body.omega_rad_s;
  return out;
}

Renderer::Renderer(const World& world, const Trajectory& trajectory, const CameraRig& rig)
    : world_(world), trajectory_(trajectory), rig_(rig), rays_(rig.lens) {
  row_poses_.resize(rays_.rows + 1);
  surfaces_.reserve(kMaxSurfaces);
  triangles_.reserve(kMaxTriangles);
  coefficients_.reserve(kMaxTriangles);
  nodes_.reserve(kMaxNodes);
  heads_.resize(rays_.tiles.size());
  const std::size_t pixels = rays_.x.size();
  radiance_.resize(pixels);
  inverse_depth_.resize(pixels);
  ground_.resize(pixels);
  mover_mask_.resize(pixels);
  mover_pixels_.resize(world.movers().size() + 1);
  movers_.reserve(world.movers().size());
  boxes_.reserve(world.movers().size());
  corner_cache_.resize(160 * 160);
  haze_radiance_ = world.plan().night ? 4.0f : 205.0f;
}

Renderer::~Renderer() = default;

Renderer::RowPose Renderer::row_pose(double row, double t_s) const {
  const double height = rig_.lens.height;
  const double dt = (row - (height - 1) / 2) / std::max(1.0, height - 1) * rig_.readout_s;
  const CameraPose at = camera_pose(trajectory_, rig_, t_s + dt);
  RowPose out;
  out.R = at.R_world_cam.transpose() * pose_.R_world_cam;
  out.t = at.R_world_cam.transpose() * (pose_.position_m - at.position_m);
  out.dt_s = dt;
  return out;
}

void Renderer::render(double t_s) {
  pose_ = camera_pose(trajectory_, rig_, t_s);
  margin_ = 0;
  if (rig_.readout_s > 0) {
    for (int r = 0; r <= rays_.rows; ++r) row_poses_[r] = row_pose(r * kTile - 0.5, t_s);
    for (const RowPose* p : {&row_poses_.front(), &row_poses_.back()}) {
      const double turn = Eigen::AngleAxisd(p->R).angle();
      // Nothing that matters is closer than a metre; movers add their own motion.
      margin_ = std::max(margin_, static_cast<float>(3.0 * turn + p->t.norm() + 0.5 * rig_.readout_s));
    }
  }
  collect(t_s);
  std::fill(mover_pixels_.begin(), mover_pixels_.end(), 0);
  for (int row = 0; row < rays_.rows; ++row) {
    for (int column = 0; column < rays_.columns; ++column) draw_tile(column, row);
  }
  cast_mover_shadows(t_s);
  find_boxes();
}

bool Renderer::coefficients(const double v[3][3], Coefficients* out) {
  const auto cross = [](const double* a, const double* b, double* c) {
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
  };
  double e[3][3];
  cross(v[1], v[2], e[0]);
  cross(v[2], v[0], e[1]);
  cross(v[0], v[1], e[2]);
  const double det = v[0][0] * e[0][0] + v[0][1] * e[0][1] + v[0][2] * e[0][2];
  if (det > -1e-12) return false;  // seen from behind, or edge-on
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) out->e[i][k] = static_cast<float>(-e[i][k]);
    out->q[i] = static_cast<float>((e[0][i] + e[1][i] + e[2][i]) / det);
  }
  return true;
}

bool Renderer::in_sight(const Vec3& c, double radius) const {
  if (c.z() < -radius) return false;
  const auto outside = [&](double x, double z) { return x / std::sqrt(1 + z * z) > radius; };
  const double m = margin_;
  return !outside(c.x() - (rays_.x_max + m) * c.z(), rays_.x_max + m) &&
         !outside((rays_.x_min - m) * c.z() - c.x(), rays_.x_min - m) &&
         !outside(c.y() - (rays_.y_max + m) * c.z(), rays_.y_max + m) &&
         !outside((rays_.y_min - m) * c.z() - c.y(), rays_.y_min - m);
}

void Renderer::add_triangle(const Vec3& a, const Vec3& b, const Vec3& c, std::uint32_t surface) {
  const double m = margin_, xl = rays_.x_min - m, xh = rays_.x_max + m, yl = rays_.y_min - m, yh = rays_.y_max + m;
  const auto all = [&](auto outside) { return outside(a) && outside(b) && outside(c); };
  if (all([&](const Vec3& p) { return p.z() < kNear; }) || all([&](const Vec3& p) { return p.x() < xl * p.z(); }) ||
      all([&](const Vec3& p) { return p.x() > xh * p.z(); }) ||
      all([&](const Vec3& p) { return p.y() < yl * p.z(); }) ||
      all([&](const Vec3& p) { return p.y() > yh * p.z(); })) {
    return;
  }
  const double v[3][3] = {{a.x(), a.y(), a.z()}, {b.x(), b.y(), b.z()}, {c.x(), c.y(), c.z()}};
  Coefficients k{};
  if (!coefficients(v, &k) && margin_ == 0) return;
  // Bounds in ray space; a triangle that reaches behind the eye may be anywhere.
  float x0 = static_cast<float>(xl), x1 = static_cast<float>(xh), y0 = static_cast<float>(yl),
        y1 = static_cast<float>(yh);
  if (a.z() > kNear && b.z() > kNear && c.z() > kNear) {
    const double ax = a.x() / a.z(), bx = b.x() / b.z(), cx = c.x() / c.z();
    const double ay = a.y() / a.z(), by = b.y() / b.z(), cy = c.y() / c.z();
    x0 = static_cast<float>(std::min({ax, bx, cx}) - m);
    x1 = static_cast<float>(std::max({ax, bx, cx}) + m);
    y0 = static_cast<float>(std::min({ay, by, cy}) - m);
    y1 = static_cast<float>(std::max({ay, by, cy}) + m);
  }
  if (triangles_.size() >= kMaxTriangles) {
    ++dropped_;
    return;
  }
  const std::uint32_t index = static_cast<std::uint32_t>(triangles_.size());
  Triangle t;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) t.vertex[i][j] = static_cast<float>(v[i][j]);
  }
  t.surface = surface;
  triangles_.push_back(t);
  coefficients_.push_back(k);
  int c0 = 0, c1 = rays_.columns - 1, r0 = 0, r1 = rays_.rows - 1;
  while (c0 <= c1 && rays_.column_max[c0] < x0) ++c0;
  while (c1 >= c0 && rays_.column_min[c1] > x1) --c1;
  while (r0 <= r1 && rays_.row_max[r0] < y0) ++r0;
  while (r1 >= r0 && rays_.row_min[r1] > y1) --r1;
  for (int r = r0; r <= r1; ++r) {
    for (int col = c0; col <= c1; ++col) {
      const std::size_t at = r * rays_.columns + col;
      const RayTable::Tile& tile = rays_.tiles[at];
      if (tile.x_max < x0 || tile.x_min > x1 || tile.y_max < y0 || tile.y_min > y1) continue;
      if (margin_ == 0) {  // an edge that leaves the whole tile outside
        bool out = false;
        for (const auto& e : k.e) {
          out = out ||
                e[0] * (e[0] > 0 ? tile.x_max : tile.x_min) + e[1] * (e[1] > 0 ? tile.y_max : tile.y_min) + e[2] < 0;
        }
        if (out) continue;
      }
      if (nodes_.size() >= kMaxNodes) {
        ++dropped_;
        return;
      }
      nodes_.push_back({index, heads_[at]});
      heads_[at] = static_cast<std::uint32_t>(nodes_.size() - 1);
    }
  }
}

Renderer::FrameSurface Renderer::frame_surface(const Surface& s, const Mat3& R_world_thing,
                                               const Vec3& offset_m) const {
  // texel = (p_thing - origin).u + u0, and p_thing = R^T (p_world - offset); the constant part is reduced by whole
  // pictures, so that float keeps a hundredth of a texel.
  const Mat3 R_thing_cam = R_world_thing.transpose() * pose_.R_world_cam;
  const Vec3 eye = R_world_thing.transpose() * (pose_.position_m - offset_m) - s.origin.cast<double>();
  const Vec3 u = s.u.cast<double>(), v = s.v.cast<double>();
  FrameSurface out{};
  out.texture = &world_.textures()[s.texture];
  const double size = out.texture->size;
  Eigen::Map<Vec3f>(out.u) = (R_thing_cam.transpose() * u).cast<float>();
  Eigen::Map<Vec3f>(out.v) = (R_thing_cam.transpose() * v).cast<float>();
  out.u0 = static_cast<float>(std::fmod(eye.dot(u) + s.u0, size));
  out.v0 = static_cast<float>(std::fmod(eye.dot(v) + s.v0, size));
  Eigen::Map<Vec3f>(out.normal) = (R_thing_cam.transpose() * s.normal.cast<double>()).cast<float>();
  out.detail_ratio = s.detail_ratio;
  out.albedo = s.albedo * s.light;
  return out;
}

void Renderer::add_terrain(double reach_m, int step, double lower_m, std::uint32_t surface) {
  const Terrain& terrain = world_.terrain();
  const double cell = Terrain::kCellM * step;
  const int n = static_cast<int>(2 * reach_m / cell);
  const int i0 = static_cast<int>(std::floor((pose_.position_m.x() - reach_m) / cell));
  const int j0 = static_cast<int>(std::floor((pose_.position_m.y() - reach_m) / cell));
  const Mat3 R = pose_.R_world_cam.transpose();
  const int side = n + 1;
  for (int j = 0; j < side; ++j) {
    for (int i = 0; i < side; ++i) {
      const Vec3 p((i0 + i) * cell, (j0 + j) * cell, terrain.corner((i0 + i) * step, (j0 + j) * step) - lower_m);
      corner_cache_[j * side + i] = R * (p - pose_.position_m);
    }
  }
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < n; ++i) {
      const Vec3* row = &corner_cache_[j * side + i];
      const Vec3 &p00 = row[0], &p10 = row[1], &p01 = row[side], &p11 = row[side + 1];
      if (!in_sight(0.5 * (p00 + p11), cell)) continue;
      add_triangle(p00, p10, p11, surface);
      add_triangle(p00, p11, p01, surface);
    }
  }
}

void Renderer::add_objects() {
  const Mat3 R = pose_.R_world_cam.transpose();
  const Mesh& mesh = world_.mesh();
  for (const StaticObject& o : world_.objects()) {
    const Vec3 centre = o.centre.cast<double>();
    const Vec3 shift(nearest_copy(centre.x(), pose_.position_m.x()), nearest_copy(centre.y(), pose_.position_m.y()), 0);
    const Vec3 from_eye = centre + shift - pose_.position_m;
    if (from_eye.norm() - o.radius > kObjectReachM || !in_sight(R * from_eye, o.radius)) continue;
    // Smaller than a pixel: nothing that a feature could hold on to.
    if (o.radius * rig_.lens.fx < kLeastRadiusPx * from_eye.norm()) continue;
    if (surfaces_.size() + o.surfaces > kMaxSurfaces) {
      ++dropped_;
      continue;
    }
    const std::uint32_t base = static_cast<std::uint32_t>(surfaces_.size());
    for (std::uint32_t i = 0; i < o.surfaces; ++i) {
      surfaces_.push_back(frame_surface(mesh.surfaces[o.first_surface + i], Mat3::Identity(), shift));
    }
    const Vec3 offset = shift - pose_.position_m;
    for (std::uint32_t i = 0; i < o.triangles; ++i) {
      const MeshTriangle& t = mesh.triangles[o.first_triangle + i];
      const auto at = [&](int k) -> Vec3 { return R * (mesh.vertices[t.vertex[k]].cast<double>() + offset); };
      add_triangle(at(0), at(1), at(2), base + t.surface - o.first_surface);
    }
  }
}

void Renderer::add_movers(double t_s) {
  const Mat3 R = pose_.R_world_cam.transpose();
  for (std::size_t i = 0; i < world_.movers().size(); ++i) {
    const Mover& mover = world_.movers()[i];
    const MoverModel& model = world_.models()[mover.model];
    MoverInSight seen{static_cast<int>(i), 0, 0, Vec3::Zero(), world_.mover_at(static_cast<int>(i), t_s), Vec3::Zero()};
    const Vec3& at = seen.state.position_m;
    seen.shift = Vec3(nearest_copy(at.x(), pose_.position_m.x()), nearest_copy(at.y(), pose_.position_m.y()), 0);
    const Vec3 centre = at + seen.shift + Vec3(0, 0, model.height_m / 2) - pose_.position_m;
    if (centre.norm() > kMoverReachM || !in_sight(R * centre, model.radius_m)) continue;
    if (surfaces_.size() + model.mesh.surfaces.size() > kMaxSurfaces) {
      ++dropped_;
      continue;
    }
    seen.velocity_cam = R * seen.state.velocity_m_s;
    const std::uint32_t base = static_cast<std::uint32_t>(surfaces_.size());
    for (const Surface& s : model.mesh.surfaces) {
      FrameSurface f = frame_surface(s, seen.state.R_world_mover, at + seen.shift);
      const Vec3 normal = seen.state.R_world_mover * s.normal.cast<double>();
      f.albedo = static_cast<float>(s.albedo * mover.albedo * world_.irradiance(normal, at));
      Eigen::Map<Vec3f>(f.velocity) = seen.velocity_cam.cast<float>();
      f.mover = static_cast<std::uint16_t>(i + 1);
      surfaces_.push_back(f);
    }
    seen.first_triangle = static_cast<std::uint32_t>(triangles_.size());
    const auto place = [&](std::uint32_t k) -> Vec3 {
      Vec3 p = model.mesh.vertices[k].cast<double>();
      for (const MoverPart& part : model.parts) {
        if (k - part.first_vertex >= part.vertices) continue;
        const double angle = mover.moving ? part.swing_rad * std::sin(seen.state.stride_phase) : 0.0;
        const Vec3 joint = part.joint.cast<double>();
        p = joint + Eigen::AngleAxisd(angle, Vec3::UnitY()) * (p - joint);
      }
      return R * (seen.state.R_world_mover * p + at + seen.shift - pose_.position_m);
    };
    for (const MeshTriangle& t : model.mesh.triangles) {
      add_triangle(place(t.vertex[0]), place(t.vertex[1]), place(t.vertex[2]), base + t.surface);
    }
    seen.end_triangle = static_cast<std::uint32_t>(triangles_.size());
    movers_.push_back(seen);
  }
}

void Renderer::collect(double t_s) {
  surfaces_.clear();
  triangles_.clear();
  coefficients_.clear();
  nodes_.clear();
  movers_.clear();
  dropped_ = 0;
  std::fill(heads_.begin(), heads_.end(), kNoNode);
  Surface ground;
  ground.texture = kTexGround;
  const float texels_a_metre = static_cast<float>(world_.plan().ground_texels / kWorldM);
  ground.u = Vec3f(texels_a_metre, 0, 0);
  ground.v = Vec3f(0, texels_a_metre, 0);
  ground.detail_ratio = static_cast<float>(kDetailTexelsPerM) / texels_a_metre;
  FrameSurface flat = frame_surface(ground, Mat3::Identity(), Vec3::Zero());
  flat.ground = true;
  Surface sky;
  sky.texture = kTexCloud;
  sky.u = Vec3f(kCloudTexelsPerM, 0, 0);
  sky.v = Vec3f(0, kCloudTexelsPerM, 0);
  sky.detail_ratio = 1000;
  sky.albedo = world_.plan().night ? 0.02f : 1.0f;
  surfaces_.push_back(flat);  // kBackground: never shaded
  surfaces_.push_back(flat);
  surfaces_.push_back(flat);
  surfaces_.push_back(frame_surface(sky, Mat3::Identity(), Vec3::Zero()));
  static_assert(kBackground == 0 && kGround == 1 && kFarGround == 2 && kSky == 3);
  add_terrain(kGroundReachM, 1, 0.0, kGround);
  if (world_.plan().kind != WorldKind::kCorridor) {
    add_terrain(kFarReachM, 8, 1.5 + 0.02 * world_.plan().relief_m, kFarGround);
    const Mat3 R = pose_.R_world_cam.transpose();
    const double s = 2e4, z = kSkyM - pose_.position_m.z();
    const auto at = [&](double x, double y) -> Vec3 { return R * Vec3(x, y, z); };
    add_triangle(at(-s, -s), at(s, s), at(s, -s), kSky);
    add_triangle(at(-s, -s), at(-s, s), at(s, s), kSky);
  }
  add_objects();
  add_movers(t_s);
}

}  // namespace godwit::sim
