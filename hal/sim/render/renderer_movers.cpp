// The movers in a drawn picture: their true boxes, and the shadows that they cast on the ground.
#include <algorithm>
#include <cmath>
#include <utility>

#include "hal/sim/render/renderer.h"

namespace godwit::sim {

Vec2 Renderer::project_rolling(const Vec3& p_mid, const Vec3& velocity_cam) const {
  Vec2 px = rig_.lens.project(Vec2(p_mid.x() / p_mid.z(), p_mid.y() / p_mid.z()));
  if (rig_.readout_s <= 0) return px;
  for (int i = 0; i < 3; ++i) {  // the row decides the pose, the pose the row
    const double at = std::clamp((px.y() + 0.5) / kTile, 0.0, static_cast<double>(rays_.rows) - 1e-9);
    const auto k = static_cast<std::size_t>(at);
    const double f = at - static_cast<double>(k);
    const auto seen = [&](const RowPose& r) -> Vec3 { return r.R * (p_mid + r.dt_s * velocity_cam) + r.t; };
    const Vec3 p = (1 - f) * seen(row_poses_[k]) + f * seen(row_poses_[k + 1]);
    px = rig_.lens.project(Vec2(p.x() / p.z(), p.y() / p.z()));
  }
  return px;
}

void Renderer::find_boxes() {
  boxes_.clear();
  for (const MoverInSight& seen : movers_) {
    const int pixels = mover_pixels_[seen.mover + 1];
    if (pixels == 0) continue;
    const Mover& mover = world_.movers()[seen.mover];
    TrueBox box{seen.mover, mover.kind, mover.moving, 1e9, 1e9, -1e9, -1e9, pixels};
    bool around_eye = false;
    for (std::uint32_t t = seen.first_triangle; t < seen.end_triangle; ++t) {
      for (const auto& v : triangles_[t].vertex) {
        const Vec3 p(v[0], v[1], v[2]);
        if (p.z() < kNear) {
          around_eye = true;
          continue;
        }
        const Vec2 px = project_rolling(p, seen.velocity_cam);
        // Pixel (0, 0) is a centre: its square begins half a pixel before.
        box.x0 = std::min(box.x0, px.x() + 0.5);
        box.y0 = std::min(box.y0, px.y() + 0.5);
        box.x1 = std::max(box.x1, px.x() + 0.5);
        box.y1 = std::max(box.y1, px.y() + 0.5);
      }
    }
    if (around_eye) box.x0 = box.y0 = 0, box.x1 = rig_.lens.width, box.y1 = rig_.lens.height;
    box.x0 = std::clamp(box.x0, 0.0, static_cast<double>(rig_.lens.width));
    box.x1 = std::clamp(box.x1, 0.0, static_cast<double>(rig_.lens.width));
    box.y0 = std::clamp(box.y0, 0.0, static_cast<double>(rig_.lens.height));
    box.y1 = std::clamp(box.y1, 0.0, static_cast<double>(rig_.lens.height));
    boxes_.push_back(box);
  }
}

void Renderer::cast_mover_shadows(double) {
  const WorldPlan& plan = world_.plan();
  const bool sun = !plan.night && plan.kind != WorldKind::kCorridor && world_.sun().z() > 0.1;
  const Vec2 cast = sun ? Vec2(-world_.sun().x() / world_.sun().z(), -world_.sun().y() / world_.sun().z()) : Vec2(0, 0);
  const float dark = sun ? static_cast<float>(plan.ambient * 0.9) : 0.6f;
  const Mat3 R = pose_.R_world_cam.transpose();
  for (const MoverInSight& seen : movers_) {
    const MoverModel& model = world_.models()[world_.movers()[seen.mover].model];
    const Vec3 at = seen.state.position_m + seen.shift;
    const Vec2 ahead = seen.state.R_world_mover.col(0).head<2>().normalized(), left(-ahead.y(), ahead.x());
    // Bounds in the picture of the ground below thing and shadow.
    double x0 = 1e9, y0 = 1e9, x1 = -1e9, y1 = -1e9;
    bool hidden = false;
    for (const double a : {-1.0, 1.0}) {
      for (const double b : {-1.0, 1.0}) {
        for (const double h : {0.0, model.height_m}) {
          const Vec2 g = at.head<2>() + a * model.half_length_m * ahead + b * model.half_width_m * left + h * cast;
          const Vec3 p = R * (Vec3(g.x(), g.y(), at.z()) - pose_.position_m);
          if (p.z() < 0.3 || std::abs(p.x()) > 2 * p.z() || std::abs(p.y()) > 2 * p.z()) {
            hidden = true;
            continue;
          }
          const Vec2 px = rig_.lens.project(Vec2(p.x() / p.z(), p.y() / p.z()));
          x0 = std::min(x0, px.x());
          y0 = std::min(y0, px.y());
          x1 = std::max(x1, px.x());
          y1 = std::max(y1, px.y());
        }
      }
    }
    if (hidden) continue;
    const double m = 3 + margin_ * rig_.lens.fx;
    const int u0 = std::max(0, static_cast<int>(x0 - m)), u1 = std::min(rig_.lens.width - 1, static_cast<int>(x1 + m));
    const int v0 = std::max(0, static_cast<int>(y0 - m)), v1 = std::min(rig_.lens.height - 1, static_cast<int>(y1 + m));
    for (int v = v0; v <= v1; ++v) {
      for (int u = u0; u <= u1; ++u) {
        const std::size_t i = v * rays_.stride + u;
        if (ground_[i] == 0) continue;
        const double z = 1.0 / static_cast<double>(inverse_depth_[i]);
        const Vec3 p = pose_.R_world_cam * Vec3(rays_.x[i] * z, rays_.y[i] * z, z) + pose_.position_m - at;
        const Vec2 g = p.head<2>();
        if (!sun) {  // from all sides: darkest under its middle
          const double a = g.dot(ahead) / (1.3 * model.half_length_m), b = g.dot(left) / (1.3 * model.half_width_m);
          radiance_[i] *= 1 - static_cast<float>(std::max(0.0, 1 - a * a - b * b)) * (1 - dark);
          continue;
        }
        double low = 0, high = model.height_m;
        for (const auto& [axis, half] : {std::pair{ahead, model.half_length_m}, {left, model.half_width_m}}) {
          const double s = g.dot(axis), rate = cast.dot(axis);
          if (std::abs(rate) < 1e-6) {
            if (std::abs(s) > half) high = -1;
            continue;
          }
          low = std::max(low, std::min((s - half) / rate, (s + half) / rate));
          high = std::min(high, std::max((s - half) / rate, (s + half) / rate));
        }
        if (high <= low) continue;
        const float cover = static_cast<float>(std::min(1.0, (high - low) / (0.12 * model.height_m)));
        radiance_[i] *= 1 - cover * (1 - dark);
      }
    }
  }
}

}  // namespace godwit::sim
