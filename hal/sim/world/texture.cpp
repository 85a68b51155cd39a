#include "hal/sim/world/texture.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace godwit::sim {
namespace {
std::uint8_t to_byte(double v) {
  return static_cast<std::uint8_t>(std::clamp(v + 0.5, 0.0, 255.0));
}
}  // namespace

Canvas::Canvas(int size) : size_(size), brightness_(size * size, 128), grain_(brightness_.size(), 64) {
  assert(size >= 4 && (size & (size - 1)) == 0);
}

void Canvas::fill(double brightness, double grain) {
  std::fill(brightness_.begin(), brightness_.end(), to_byte(brightness));
  std::fill(grain_.begin(), grain_.end(), to_byte(grain));
}

void Canvas::scale_row(int y, std::span<const float> factors) {
  std::uint8_t* out = &brightness_[index(0, y)];
  for (int x = 0; x < size_; ++x) {
    const float value = static_cast<float>(out[x]) * factors[x] + 0.5f;
    out[x] = static_cast<std::uint8_t>(std::min(255.0f, std::max(0.0f, value)));
  }
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
      const double cover = std::clamp(
          radius - std::sqrt((x + 0.5 - cx) * (x + 0.5 - cx) + (y + 0.5 - cy) * (y + 0.5 - cy)) + 0.5, 0.0, 1.0);
      if (cover > 0) blend(x, y, cover, brightness, grain);
    }
  }
}

void Canvas::noise(std::span<const int> cells, double amplitude, std::uint64_t seed, bool by_grain) {
  // Value noise: random values on a lattice, smooth steps between. All sizes are summed before they touch the picture,
  // so that rounding to 8 bits happens once.
  struct Octave {
    int cell, lattice;
    std::vector<float> values, row, weight;
  };
  std::vector<Octave> octaves;
  for (const int cell : cells) {
    // The finest noise repeats after a while: nobody sees it, and it need not be made for the whole world.
    Octave o{cell, std::clamp(size_ / cell, 1, 1024), {}, {}, {}};
    o.values.resize(o.lattice * o.lattice);
    Rng rng(seed, static_cast<std::uint64_t>(cell));
    for (float& v : o.values) v = static_cast<float>(rng.uniform(-1, 1));
    o.row.resize(size_ / cell + 2);
    for (int i = 0; i < cell; ++i) {
      const float t = (static_cast<float>(i) + 0.5f) / static_cast<float>(cell);
      o.weight.push_back(t * t * (3 - 2 * t));
    }
    octaves.push_back(std::move(o));
  }
  std::vector<float> sum(size_);
  const float gain = static_cast<float>(amplitude) * (by_grain ? 1.0f / 128.0f : 1.0f);
  for (int y = 0; y < size_; ++y) {
    std::fill(sum.begin(), sum.end(), 0.0f);
    for (Octave& o : octaves) {
      const int n = std::max(1, size_ / o.cell), a = (y / o.cell) % o.lattice, b = (a + 1) % o.lattice;
      const float wy = o.weight[y % o.cell];
      const float *va = &o.values[a * o.lattice], *vb = &o.values[b * o.lattice];
      for (int i = 0; i <= n; ++i) {
        const int k = i & (o.lattice - 1);
        o.row[i] = va[k] + wy * (vb[k] - va[k]);
      }
      float* out = sum.data();
      const float* row = o.row.data();
      if (o.cell == 1) {  // its weight is one half throughout
        for (int i = 0; i < n; ++i) out[i] += 0.5f * (row[i] + row[i + 1]);
        continue;
      }
      for (int i = 0; i < n; ++i, out += o.cell) {
        const float v = row[i], step = row[i + 1] - v;
        for (int k = 0; k < o.cell; ++k) out[k] += v + o.weight[k] * step;
      }
    }
    std::uint8_t* out = &brightness_[index(0, y)];
    const std::uint8_t* grain = &grain_[index(0, y)];
    for (int x = 0; x < size_; ++x) {
      const float g = by_grain ? gain * static_cast<float>(grain[x]) : gain;
      const float value = static_cast<float>(out[x]) * (1.0f + g * sum[x]) + 0.5f;
      out[x] = static_cast<std::uint8_t>(std::min(255.0f, std::max(0.0f, value)));
    }
  }
}

Texture::Texture(const Canvas& canvas) : size(canvas.size()) {
  const std::size_t texels_0 = size * size;
  std::vector<std::uint8_t> b(texels_0), g(texels_0);
  for (int y = 0; y < size; ++y) {
    for (int x = 0; x < size; ++x) {
      const std::size_t i = y * size + x;
      b[i] = canvas.brightness(x, y);
      g[i] = canvas.grain(x, y);
    }
  }
  texels.reserve(texels_0 / 3 * 4 + 4);
  for (int s = size; s >= 1 && levels < kMaxLevels; s /= 2, ++levels) {
    offset[levels] = static_cast<int>(texels.size());
    const auto at = [s](int x, int y) { return (y & (s - 1)) * s + (x & (s - 1)); };
    const auto half = [&](int x, int y) { return std::min((b[at(x, y)] + ((x ^ y) & 1u)) >> 1u, 127u); };
    for (int y = 0; y < s; ++y) {
      for (int x = 0; x < s; ++x) {
        texels.push_back(half(x, y) | half(x + 1, y) << 7u | half(x, y + 1) << 14u | half(x + 1, y + 1) << 21u |
                         static_cast<std::uint32_t>(g[at(x, y)] >> 4u) << 28u);
      }
    }
    // In place: a texel of the next level lies before the four it is made of, or on the first of them.
    for (int y = 0; y < s / 2; ++y) {
      for (int x = 0; x < s / 2; ++x) {
        const auto mean = [&](const std::vector<std::uint8_t>& c) {
          return static_cast<std::uint8_t>((c[at(2 * x, 2 * y)] + c[at(2 * x + 1, 2 * y)] + c[at(2 * x, 2 * y + 1)] +
                                            c[at(2 * x + 1, 2 * y + 1)] + 2) /
                                           4);
        };
        const std::size_t to = y * (s / 2) + x;
        const std::uint8_t mean_b = mean(b), mean_g = mean(g);
        b[to] = mean_b;
        g[to] = mean_g;
      }
    }
  }
}

}  // namespace godwit::sim
