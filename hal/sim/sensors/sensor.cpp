#include "hal/sim/sensors/sensor.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "hal/sim/world/random.h"

namespace godwit::sim {
namespace {
constexpr std::size_t kNoiseValues = 1u << 16;
constexpr int kMaxTaps = 24;
constexpr float kLeastBlurPx = 0.3f;
}  // namespace

Sensor::Sensor(const SensorModel& model, const CameraRig& rig, const Vec3& sun_world, std::uint64_t seed)
    : model_(model), rig_(rig), sun_world_(sun_world), seed_(seed) {
  const std::size_t tile = kTile;
  const std::size_t stride = (rig.lens.width + tile - 1) / tile * tile;
  blurred_.resize(stride * ((rig.lens.height + tile - 1) / tile * tile));
  veil_.resize(stride);
  noise_.resize(kNoiseValues + stride);
  Rng rng(seed, 0x9015e);
  for (float& n : noise_) n = static_cast<float>(rng.gaussian());
}

double Sensor::mean_of(const Renderer& scene) const {
  double sum = 0;
  int count = 0;
  for (int v = 4; v < rig_.lens.height; v += 8) {
    for (int u = 4; u < rig_.lens.width; u += 8, ++count)
      sum += static_cast<double>(std::min(scene.radiance()[v * scene.stride() + u], 400.0f));
  }
  return sum / count;
}

void Sensor::blur(const Renderer& scene) {
  // Every pixel averages the picture along its own image motion during the exposure. The motion is that of still
  // things; flow of the ray (X, Y, 1) under the camera's velocity v and rate w, depth z (Longuet-Higgins and Prazdny,
  // 1980): X' = -vx/z - wy + wz Y + X (vz/z + wx Y - wy X), Y' = -vy/z + wx - wz X + Y (vz/z + wx Y - wy X).
  const RayTable& rays = scene.rays();
  const CameraPose& pose = scene.pose();
  const float e = static_cast<float>(model_.exposure_ms * 1e-3);
  const float kx = e * static_cast<float>(rig_.lens.fx), ky = e * static_cast<float>(rig_.lens.fy);
  const Vec3f v = pose.velocity_cam_m_s.cast<float>(), w = pose.omega_cam_rad_s.cast<float>();
  const int width = rig_.lens.width, height = rig_.lens.height, stride = rays.stride;
  const float* in = scene.radiance();
  const auto at = [&](float x, float y) {
    x = std::clamp(x, 0.0f, static_cast<float>(width - 1) - 0.001f);
    y = std::clamp(y, 0.0f, static_cast<float>(height - 1) - 0.001f);
    const int ix = static_cast<int>(x), iy = static_cast<int>(y);
    const float fx = x - static_cast<float>(ix), fy = y - static_cast<float>(iy);
    const float* p = in + iy * stride + ix;
    const float a = p[0] + fx * (p[1] - p[0]), b = p[stride] + fx * (p[stride + 1] - p[stride]);
    return a + fy * (b - a);
  };
  for (int r = 0; r < height; ++r) {
    for (int c = 0; c < width; ++c) {
      const std::size_t i = r * stride + c;
      const float X = rays.x[i], Y = rays.y[i], inverse = scene.inverse_depth()[i];
      const float common = v.z() * inverse + w.x() * Y - w.y() * X;
      const float mx = kx * (-v.x() * inverse - w.y() + w.z() * Y + X * common);
      const float my = ky * (-v.y() * inverse + w.x() - w.z() * X + Y * common);
      const float length = std::sqrt(mx * mx + my * my);
      if (length < kLeastBlurPx) {
        blurred_[i] = in[i];
        continue;
      }
      const int taps = std::clamp(static_cast<int>(length) + 2, 2, kMaxTaps);
      float sum = 0;
      for (int k = 0; k < taps; ++k) {
        const float f = (static_cast<float>(k) + 0.5f) / static_cast<float>(taps) - 0.5f;
        sum += at(static_cast<float>(c) + f * mx, static_cast<float>(r) + f * my);
      }
      blurred_[i] = sum / static_cast<float>(taps);
    }
  }
}

void Sensor::control(const Renderer& scene, double t_s) {
  double wanted = model_.gain;
  for (const GainStep& step : model_.gain_steps) {
    if (t_s >= step.t_s) wanted = model_.gain * step.factor;
  }
  if (model_.auto_exposure) {
    const double ideal = std::clamp(model_.mean_target / std::max(1.0, mean_of(scene)), 0.2, 24.0);
    // As cameras do: a part of the way each frame.
    gain_ = gain_ <= 0 ? ideal : gain_ * std::pow(ideal / gain_, 0.12);
    wanted *= gain_;
  } else {
    gain_ = wanted;
  }
  wanted_ = wanted;
}

void Sensor::expose(const Renderer& scene, double t_s, std::uint32_t index, const rt::MutableImageView& grey) {
  const int width = rig_.lens.width, height = rig_.lens.height, stride = scene.stride();
  control(scene, t_s);
  const double wanted = wanted_;
  blur(scene);

  const RayTable& rays = scene.rays();
  const double corner = std::max(rays.x_max * rays.x_max + rays.y_max * rays.y_max, 1e-6f);
  const float fall = static_cast<float>(model_.vignetting / corner);
  const Vec3 sun = scene.pose().R_world_cam.transpose() * sun_world_;
  const float sx = static_cast<float>(sun.x()), sy = static_cast<float>(sun.y()), sz = static_cast<float>(sun.z());
  const float glare = static_cast<float>(model_.glare),
              read2 = static_cast<float>(model_.read_noise * model_.read_noise);
  const float shot = static_cast<float>(model_.shot_noise * std::max(1.0, wanted));
  const double line_s = height > 1 ? rig_.readout_s / (height - 1) : 0;
  const double phase_width = std::numbers::pi * model_.flicker_hz * model_.exposure_ms * 1e-3;
  // A lamp's light averaged over the exposure: the longer it is, the weaker the flicker.
  const double depth = model_.flicker_depth * (phase_width > 1e-9 ? std::sin(phase_width) / phase_width : 1.0);
  for (int r = 0; r < height; ++r) {
    const double t_row = t_s + (r - (height - 1) / 2.0) * line_s;
    const float gain =
        static_cast<float>(wanted * (1 + depth * std::cos(2 * std::numbers::pi * model_.flicker_hz * t_row)));
    const std::size_t first = r * stride;
    const float *x = &rays.x[first], *y = &rays.y[first], *in = &blurred_[first];
    if (glare > 0) {
      for (int c = 0; c < width; ++c) {
        // Angle to the sun: a bright core and a wide veil.
        const float cosine = (x[c] * sx + y[c] * sy + sz) / std::sqrt(x[c] * x[c] + y[c] * y[c] + 1.0f);
        const float a = 1.0f - cosine;
        veil_[c] = glare * (3.0f / (1.0f + 4000.0f * a * a * 40.0f) + 0.6f / (1.0f + 14.0f * a));
      }
    }
    const float* noise = noise_.data() + (mix(seed_ ^ index, static_cast<std::uint64_t>(r)) & (kNoiseValues - 1));
    std::uint8_t* out = grey.row(r);
    const float veil_gain = gain / static_cast<float>(std::max(1e-6, model_.gain));
    for (int c = 0; c < width; ++c) {
      const float shade = 1.0f - fall * (x[c] * x[c] + y[c] * y[c]);
      float value = in[c] * gain * shade;
      if (glare > 0) value += veil_gain * veil_[c];
      value += noise[c] * std::sqrt(read2 + shot * value);
      out[c] = static_cast<std::uint8_t>(std::min(255.0f, std::max(0.0f, value + 0.5f)));
    }
  }
}

}  // namespace godwit::sim
