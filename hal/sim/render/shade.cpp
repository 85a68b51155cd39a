// From surfaces to light: materials looked up tri-linearly, fine detail, haze.
#include <algorithm>
#include <cmath>
#include <hwy/highway.h>

#include "hal/sim/render/renderer.h"

namespace hn = hwy::HWY_NAMESPACE;

namespace godwit::sim {
namespace {
using D = hn::CappedTag<float, 8>;
using DI = hn::RebindToSigned<D>;
using DU = hn::RebindToUnsigned<D>;
using V = hn::Vec<D>;
constexpr int kMaxLanes = 8;

struct Lookup {
  V brightness, grain;
};

/// Bilinear lookup in one level; u, v in texels of level 0.
template <bool kGrain>
Lookup bilinear(const Texture& texture, int level, V u, V v) {
  const D d;
  const DI di;
  const DU du;
  const V scale = hn::Set(d, 1.0f / static_cast<float>(1 << level)), half = hn::Set(d, 0.5f);
  const V x = hn::Sub(hn::Mul(u, scale), half), y = hn::Sub(hn::Mul(v, scale), half);
  const V fx = hn::Floor(x), fy = hn::Floor(y);
  const V a = hn::Sub(x, fx), b = hn::Sub(y, fy);
  const auto mask = hn::Set(di, (texture.size >> level) - 1);
  const auto ix = hn::And(hn::ConvertTo(di, fx), mask), iy = hn::And(hn::ConvertTo(di, fy), mask);
  const auto index = hn::Add(hn::Mul(iy, hn::Set(di, texture.size >> level)), ix);
  const auto* base = reinterpret_cast<const std::int32_t*>(texture.texels.data() + texture.offset[level]);
  const auto quad = hn::BitCast(du, hn::GatherIndex(di, base, index));
  const auto bits = hn::Set(du, 0x7fu);
  const auto real = [&](auto value) { return hn::ConvertTo(d, hn::BitCast(di, value)); };
  const auto mix = [](V p, V q, V t) { return hn::MulAdd(t, hn::Sub(q, p), p); };
  const V top = mix(real(hn::And(quad, bits)), real(hn::And(hn::ShiftRight<7>(quad), bits)), a);
  const V bottom = mix(real(hn::And(hn::ShiftRight<14>(quad), bits)), real(hn::And(hn::ShiftRight<21>(quad), bits)), a);
  Lookup out;
  out.brightness = hn::Mul(mix(top, bottom, b), hn::Set(d, 2.0f));
  if constexpr (kGrain) {
    out.grain = hn::Mul(real(hn::ShiftRight<28>(quad)), hn::Set(d, 16.0f));
  } else {
    out.grain = out.brightness;
  }
  return out;
}

/// Between two levels; lod is counted from level 0 and may be negative (magnified).
template <bool kGrain>
Lookup trilinear(const Texture& texture, float lod, V u, V v) {
  const D d;
  const int last = texture.levels - 1;
  const float at = std::min(std::max(lod, 0.0f), static_cast<float>(last));
  int level = std::min(static_cast<int>(at), last);
  const float f = at - static_cast<float>(level);
  // A tenth of a level is not seen; not looking it up is a fifth of the time.
  if (f > 0.9f) level = std::min(level + 1, last);
  Lookup fine = bilinear<kGrain>(texture, level, u, v);
  if (f < 0.1f || f > 0.9f || level == last) return fine;
  const Lookup coarse = bilinear<kGrain>(texture, level + 1, u, v);
  const V t = hn::Set(d, f);
  fine.brightness = hn::MulAdd(t, hn::Sub(coarse.brightness, fine.brightness), fine.brightness);
  if constexpr (kGrain) fine.grain = hn::MulAdd(t, hn::Sub(coarse.grain, fine.grain), fine.grain);
  return fine;
}

/// Material coordinates: change a pixel to the right and a pixel down.
struct Footprint {
  float major, minor;    ///< lengths of the longer and the shorter one [texels]
  float step_u, step_v;  ///< half the longer one
};

float dot(const float* a, const float* b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

}  // namespace

void Renderer::shade_tile(int column, int row, const float* depth, const std::uint32_t* surface) {
  const D d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const RayTable::Tile& tile = rays_.tiles[row * rays_.columns + column];
  const bool rolling = rig_.readout_s > 0;
  const V haze = hn::Set(d, static_cast<float>(world_.plan().haze_m)), haze_light = hn::Set(d, haze_radiance_);
  const Texture& detail = world_.textures()[kTexDetail];

  const auto shade = [&](const FrameSurface& s, V dx, V dy, V dz, V w, int lane, V shift_x, V shift_y, V shift_z) {
    // A lane that is not covered may hold 1/z = 0: it is computed and thrown away, so keep it finite.
    const V z = hn::Div(hn::Set(d, 1.0f), hn::Max(w, hn::Set(d, 1e-6f)));
    const V px = hn::MulAdd(z, dx, shift_x), py = hn::MulAdd(z, dy, shift_y), pz = hn::MulAdd(z, dz, shift_z);
    const auto project = [&](const float* axis, float c) {
      return hn::MulAdd(px, hn::Set(d, axis[0]),
                        hn::MulAdd(py, hn::Set(d, axis[1]), hn::MulAdd(pz, hn::Set(d, axis[2]), hn::Set(d, c))));
    };
    V u = project(s.u, s.u0), v = project(s.v, s.v0);
    // Footprint of one pixel on the surface, worked out for one lane.
    alignas(64) float lx[kMaxLanes], ly[kMaxLanes], lz[kMaxLanes], lw[kMaxLanes];
    hn::Store(dx, d, lx);
    hn::Store(dy, d, ly);
    hn::Store(dz, d, lz);
    hn::Store(z, d, lw);
    const float ray[3] = {lx[lane], ly[lane], lz[lane]};
    float facing = dot(s.normal, ray);
    const float least = 0.02f * std::sqrt(dot(ray, ray));
    if (std::abs(facing) < least) facing = facing < 0 ? -least : least;
    Footprint foot{};
    float du[2], dv[2], length[2];
    const float gx[2] = {tile.dxdu, tile.dxdv}, gy[2] = {tile.dydu, tile.dydv};
    for (int k = 0; k < 2; ++k) {
      const float slide = (s.normal[0] * gx[k] + s.normal[1] * gy[k]) / facing;
      const float dp[3] = {lw[lane] * (gx[k] - slide * ray[0]), lw[lane] * (gy[k] - slide * ray[1]),
                           -lw[lane] * slide * ray[2]};
      du[k] = dot(s.u, dp);
      dv[k] = dot(s.v, dp);
      length[k] = std::sqrt(du[k] * du[k] + dv[k] * dv[k]);
    }
    const int longer = length[1] > length[0] ? 1 : 0;
    foot.major = length[longer] + 1e-9f;
    foot.minor = length[1 - longer] + 1e-9f;
    foot.step_u = 0.25f * du[longer];
    foot.step_v = 0.25f * dv[longer];
    // Seen at a slant a pixel is a long strip of ground: two lookups along it instead of one blurred over its length.
    const bool two = foot.major > 2.2f * foot.minor && foot.major > 1.0f;
    const float lod = std::log2(two ? std::max(foot.minor, 0.6f * foot.major)
                                    : std::max(0.75f * foot.major, std::sqrt(foot.major * foot.minor)));
    const auto look = [&](V at_u, V at_v) {
      const Lookup base = trilinear<true>(*s.texture, lod, at_u, at_v);
      const float fine = lod + std::log2(s.detail_ratio);
      // Far away the detail averages out.
      if (fine > 6) return base.brightness;
      const V ratio = hn::Set(d, s.detail_ratio);
      const Lookup grain = trilinear<false>(detail, fine, hn::Mul(at_u, ratio), hn::Mul(at_v, ratio));
      const V modulation = hn::Mul(hn::Sub(grain.brightness, hn::Set(d, 128.0f)),
                                   hn::Mul(base.grain, hn::Set(d, 1.0f / (128.0f * 128.0f))));
      return hn::MulAdd(base.brightness, modulation, base.brightness);
    };
    V light;
    if (two) {
      const V su = hn::Set(d, foot.step_u), sv = hn::Set(d, foot.step_v);
      light = hn::Mul(hn::Set(d, 0.5f),
                      hn::Add(look(hn::Add(u, su), hn::Add(v, sv)), look(hn::Sub(u, su), hn::Sub(v, sv))));
    } else {
      light = look(u, v);
    }
    light = hn::Mul(light, hn::Set(d, s.albedo));
    const V near = hn::Mul(haze, w);
    const V clear = hn::Div(near, hn::Add(near, hn::Set(d, 1.0f)));
    return hn::MulAdd(clear, hn::Sub(light, haze_light), haze_light);
  };

  for (int y = 0; y < kTile; ++y) {
    float R[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, t[3] = {0, 0, 0}, dt = 0;
    if (rolling) {
      // The row's rays and eye, seen from the middle row's frame.
      const RowPose &a = row_poses_[row], &b = row_poses_[row + 1];
      const double f = (y + 0.5) / kTile;
      for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) R[i][j] = static_cast<float>((1 - f) * a.R(j, i) + f * b.R(j, i));
      }
      const Vec3 eye = -(1 - f) * (a.R.transpose() * a.t) - f * (b.R.transpose() * b.t);
      for (int i = 0; i < 3; ++i) t[i] = static_cast<float>(eye[i]);
      dt = static_cast<float>((1 - f) * a.dt_s + f * b.dt_s);
    }
    for (int x = 0; x < kTile; x += lanes) {
      const int at = y * kTile + x;
      const std::size_t pixel = (row * kTile + y) * rays_.stride + column * kTile + x;
      const V rx = hn::LoadU(d, &rays_.x[pixel]), ry = hn::LoadU(d, &rays_.y[pixel]);
      V dx = rx, dy = ry, dz = hn::Set(d, 1.0f);
      if (rolling) {
        const auto turn = [&](const float* r) {
          return hn::MulAdd(hn::Set(d, r[0]), rx, hn::MulAdd(hn::Set(d, r[1]), ry, hn::Set(d, r[2])));
        };
        dx = turn(R[0]);
        dy = turn(R[1]);
        dz = turn(R[2]);
      }
      // Most groups show one still surface only.
      const std::uint32_t first_id = surface[at];
      const auto all_first = [&] {
        const DU du;
        auto same = hn::Eq(hn::Load(du, surface + at), hn::Set(du, first_id));
        for (int s = 1; s < kSamples; ++s) {
          same = hn::And(same, hn::Eq(hn::Load(du, surface + s * kTilePixels + at), hn::Set(du, first_id)));
        }
        return hn::AllTrue(du, same);
      };
      const FrameSurface& first_surface = surfaces_[first_id];
      if (first_id != 0 && first_surface.mover == 0 && all_first()) {
        V w = hn::Load(d, depth + at);
        for (int s = 1; s < kSamples; ++s) w = hn::Add(w, hn::Load(d, depth + s * kTilePixels + at));
        w = hn::Mul(w, hn::Set(d, 1.0f / kSamples));
        const V light =
            shade(first_surface, dx, dy, dz, w, lanes / 2, hn::Set(d, t[0]), hn::Set(d, t[1]), hn::Set(d, t[2]));
        hn::StoreU(light, d, &radiance_[pixel]);
        hn::StoreU(w, d, &inverse_depth_[pixel]);
        std::fill(&mover_mask_[pixel], &mover_mask_[pixel] + lanes, std::uint16_t{0});
        std::fill(&ground_[pixel], &ground_[pixel] + lanes, static_cast<std::uint8_t>(first_surface.ground));
        continue;
      }
      // Surfaces of this group with the share of each pixel they cover and their mean 1/z there.
      std::uint32_t id[kSamples * kMaxLanes];
      alignas(64) float cover[kSamples * kMaxLanes][kMaxLanes], mean[kSamples * kMaxLanes][kMaxLanes];
      int kinds = 0;
      alignas(64) std::uint16_t mask[kMaxLanes] = {};
      alignas(64) std::uint8_t on_ground[kMaxLanes];
      for (int k = 0; k < lanes; ++k) {
        int ground_samples = 0;
        for (int s = 0; s < kSamples; ++s) {
          const std::uint32_t what = surface[s * kTilePixels + at + k];
          int n = 0;
          while (n < kinds && id[n] != what) ++n;
          if (n == kinds) {
            id[kinds] = what;
            std::fill(cover[kinds], cover[kinds] + kMaxLanes, 0.0f);
            std::fill(mean[kinds], mean[kinds] + kMaxLanes, 0.0f);
            ++kinds;
          }
          cover[n][k] += 1.0f;
          mean[n][k] += depth[s * kTilePixels + at + k];
          ground_samples += surfaces_[what].ground && what != 0 ? 1 : 0;
        }
        on_ground[k] = ground_samples == kSamples ? 1 : 0;
      }
      V sum = hn::Zero(d), w_sum = hn::Zero(d);
      for (int n = 0; n < kinds; ++n) {
        const V covered = hn::Load(d, cover[n]), share = hn::Mul(covered, hn::Set(d, 1.0f / kSamples));
        const V total = hn::Load(d, mean[n]);
        w_sum = hn::Add(w_sum, total);
        if (id[n] == 0) {
          sum = hn::MulAdd(share, haze_light, sum);
          continue;
        }
        const FrameSurface& s = surfaces_[id[n]];
        const V w = hn::Div(total, hn::Max(covered, hn::Set(d, 1.0f)));
        int lane = 0;
        for (int k = 0, most = 0; k < lanes; ++k) {
          // The lane nearest to the group's middle that is covered.
          const int score = cover[n][k] > 0 ? kMaxLanes - std::abs(k - lanes / 2) : 0;
          if (score > most) most = score, lane = k;
        }
        const auto shifted = [&](int i) { return hn::Set(d, t[i] - dt * s.velocity[i]); };
        sum = hn::MulAdd(share, shade(s, dx, dy, dz, w, lane, shifted(0), shifted(1), shifted(2)), sum);
        if (s.mover != 0) {
          for (int k = 0; k < lanes; ++k) {
            if (cover[n][k] > 0 && mask[k] == 0) mask[k] = 0xffff;
          }
        }
      }
      hn::StoreU(sum, d, &radiance_[pixel]);
      hn::StoreU(hn::Mul(w_sum, hn::Set(d, 1.0f / kSamples)), d, &inverse_depth_[pixel]);
      for (int k = 0; k < lanes; ++k) {
        std::uint16_t owner = 0;
        if (mask[k] != 0) {  // the mover with at least half of the samples
          for (int s = 0; s < kSamples && owner == 0; ++s) {
            const std::uint16_t m = surfaces_[surface[s * kTilePixels + at + k]].mover;
            int same = 0;
            for (int r = 0; r < kSamples; ++r) same += surfaces_[surface[r * kTilePixels + at + k]].mover == m ? 1 : 0;
            if (m != 0 && same >= 2) owner = m;
          }
        }
        const int u = column * kTile + x + k, v = row * kTile + y;
        if (owner != 0 && u < rig_.lens.width && v < rig_.lens.height) ++mover_pixels_[owner];
        mover_mask_[pixel + k] = owner;
        ground_[pixel + k] = on_ground[k];
      }
    }
  }
}

}  // namespace godwit::sim
