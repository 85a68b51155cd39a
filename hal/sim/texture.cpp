#include "hal/sim/texture.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace godwit::sim {
namespace {
std::uint8_t to_byte(double v) {
  return static_cast<std::uint8_t>(std::clamp(v + 0.5, 0.0, 255.0));
}
}  // namespace

Canvas::Canvas(int size)
    : size_(size),
      brightness_(static_cast<std::size_t>(size) * static_cast<std::size_t>(size), 128),
      grain_(brightness_.size(), 64) {
  assert(size >= 4 && (size & (size - 1)) == 0);
}

void Canvas::fill(double brightness, double grain) {
  std::fill(brightness_.begin(), brightness_.end(), to_byte(brightness));
  std::fill(grain_.begin(), grain_.end(), to_byte(grain));
}

void Canvas::set(int x, int y, double brightness, double grain) {
  brightness_[index(x, y)] = to_byte(brightness);
  grain_[index(x, y)] = to_byte(grain);
}

void Canvas::scale(int x, int y, double factor) {
  std::uint8_t& b = brightness_[index(x, y)];
  b = to_byte(b * factor);
}

void Canvas::blend(int x, int y, double cover, double brightness, double grain) {
  const std::size_t i = index(x, y);
  brightness_[i] = to_byte(brightness_[i] + cover * (brightness - brightness_[i]));
  grain_[i] = to_byte(grain_[i] + cover * (grain - grain_[i]));
}

void Canvas::rect(double cx, double cy, double dx, double dy, double half_along, double half_across, double brightness,
                  double grain) {
  const double rx = std::abs(dx) * half_along + std::abs(dy) * half_across + 1;
  const double ry = std::abs(dy) * half_along + std::abs(dx) * half_across + 1;
  for (int y = static_cast<int>(std::floor(cy - ry)); y <= static_cast<int>(std::ceil(cy + ry)); ++y) {
    for (int x = static_cast<int>(std::floor(cx - rx)); x <= static_cast<int>(std::ceil(cx + rx)); ++x) {
      const double px = x + 0.5 - cx, py = y + 0.5 - cy;
      const double along = half_along - std::abs(px * dx + py * dy);
      const double across = half_across - std::abs(-px * dy + py * dx);
      const double cover = std::clamp(std::min(along, across) + 0.5, 0.0, 1.0);
      if (cover > 0) blend(x, y, cover, brightness, grain);
    }
  }
}

void Canvas::box(double x0, double y0, double x1, double y1, double brightness, double grain) {
  rect((x0 + x1) / 2, (y0 + y1) / 2, 1, 0, (x1 - x0) / 2, (y1 - y0) / 2, brightness, grain);
}

void Canvas::disc(double cx, double cy, double radius, double brightness, double grain) {
  for (int y = static_cast<int>(std::floor(cy - radius - 1)); y <= static_cast<int>(std::ceil(cy + radius + 1)); ++y) {
    for (int x = static_cast<int>(std::floor(cx - radius - 1)); x <= static_cast<int>(std::ceil(cx + radius + 1));
         ++x) {
      const double cover = std::clamp(radius - std::hypot(x + 0.5 - cx, y + 0.5 - cy) + 0.5, 0.0, 1.0);
      if (cover > 0) blend(x, y, cover, brightness, grain);
    }
  }
}

void Canvas::noise(int cell, double amplitude, std::uint64_t seed, bool by_grain) {
  // Value noise: random values on a lattice, smooth steps between.
  const int lattice = std::max(1, size_ / cell);
  std::vector<float> values(static_cast<std::size_t>(lattice) * static_cast<std::size_t>(lattice));
  Rng rng(seed, static_cast<std::uint64_t>(cell));
  for (float& v : values) v = static_cast<float>(rng.uniform(-1, 1));
  std::vector<float> row(static_cast<std::size_t>(lattice) + 1), weight(static_cast<std::size_t>(cell));
  for (int i = 0; i < cell; ++i) {
    const float t = (static_cast<float>(i) + 0.5f) / static_cast<float>(cell);
    weight[static_cast<std::size_t>(i)] = t * t * (3 - 2 * t);
  }
  const float gain = static_cast<float>(amplitude) * (by_grain ? 1.0f / 128.0f : 1.0f);
  for (int y = 0; y < size_; ++y) {
    const int a = (y / cell) % lattice, b = (a + 1) % lattice;
    const float wy = weight[static_cast<std::size_t>(y % cell)];
    for (int i = 0; i <= lattice; ++i) {
      const float va = values[static_cast<std::size_t>(a * lattice + i % lattice)];
      const float vb = values[static_cast<std::size_t>(b * lattice + i % lattice)];
      row[static_cast<std::size_t>(i)] = va + wy * (vb - va);
    }
    std::uint8_t* out = &brightness_[index(0, y)];
    const std::uint8_t* grain = &grain_[index(0, y)];
    for (int i = 0; i < lattice; ++i) {
      const float v = row[static_cast<std::size_t>(i)], step = row[static_cast<std::size_t>(i) + 1] - v;
      for (int k = 0; k < cell; ++k, ++out, ++grain) {
        const float n = v + weight[static_cast<std::size_t>(k)] * step;
        const float g = by_grain ? gain * static_cast<float>(*grain) : gain;
        const float value = static_cast<float>(*out) * (1.0f + g * n) + 0.5f;
        *out = static_cast<std::uint8_t>(std::min(255.0f, std::max(0.0f, value)));
      }
    }
  }
}

Texture::Texture(const Canvas& canvas) : size(canvas.size()) {
  int total = 0;
  for (int s = size; s >= 1 && levels < kMaxLevels; s /= 2, ++levels) {
    offset[levels] = total;
    stride[levels] = s + 1;
    total += (s + 1) * (s + 1);
  }
  texels.assign(static_cast<std::size_t>(total) + 2, 0);
  for (int l = 0; l < levels; ++l) {
    const int s = size >> l;
    std::uint16_t* out = texels.data() + offset[l];
    const std::uint16_t* finer = l > 0 ? texels.data() + offset[l - 1] : nullptr;
    const int finer_stride = l > 0 ? stride[l - 1] : 0;
    for (int y = 0; y < s; ++y) {
      for (int x = 0; x < s; ++x) {
        unsigned b = 0, g = 0;
        if (l == 0) {
          b = canvas.brightness(x, y);
          g = canvas.grain(x, y);
        } else {
          const std::uint16_t* q = finer + 2 * y * finer_stride + 2 * x;
          for (const std::uint16_t t : {q[0], q[1], q[finer_stride], q[finer_stride + 1]}) {
            b += t & 0xffu;
            g += t >> 8u;
          }
          b = (b + 2) / 4;
          g = (g + 2) / 4;
        }
        out[y * stride[l] + x] = static_cast<std::uint16_t>(b | (g << 8u));
      }
      out[y * stride[l] + s] = out[y * stride[l]];
    }
    std::copy(out, out + stride[l], out + s * stride[l]);
  }
}

}  // namespace godwit::sim
