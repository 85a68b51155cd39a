// One tile of the picture: which surface each of four samples a pixel sees, and how far it is.
#include <algorithm>
#include <hwy/highway.h>

#include "hal/sim/render/renderer.h"

namespace hn = hwy::HWY_NAMESPACE;

namespace godwit::sim {
namespace {
// Rotated grid: each sample has its own row and column, so that steep and flat edges are smoothed alike.
constexpr float kSampleU[kSamples] = {-0.125f, 0.375f, -0.375f, 0.125f};
constexpr float kSampleV[kSamples] = {-0.375f, -0.125f, 0.125f, 0.375f};
}  // namespace

namespace {
/// Pixels of a tile that a triangle may touch, both ends included.
struct Bounds {
  int row0 = 0, row1 = kTile - 1, column0 = 0, column1 = kTile - 1;
};

/// Grows around corners seen through the tile's map from rays to pixels, which is taken as linear.
class BoundsFinder {
 public:
  explicit BoundsFinder(const RayTable::Tile& tile)
      : tile_(tile), det_(tile.dxdu * tile.dydv - tile.dxdv * tile.dydu) {}
  void add(float x, float y, float z) {
    if (z < 0.05f) {
      unknown_ = true;
      return;
    }
    const float dx = x / z - tile_.x_centre, dy = y / z - tile_.y_centre;
    const float u = (tile_.dydv * dx - tile_.dxdv * dy) / det_, v = (tile_.dxdu * dy - tile_.dydu * dx) / det_;
    u0_ = std::min(u0_, u);
    u1_ = std::max(u1_, u);
    v0_ = std::min(v0_, v);
    v1_ = std::max(v1_, v);
  }
  Bounds bounds() const {
    Bounds out;
    // The map is linear near the tile only: trust it no further than a tile away.
    if (unknown_ || u0_ < -kTile || u1_ > kTile || v0_ < -kTile || v1_ > kTile) return out;
    constexpr float kHalf = kTile / 2.0f, kMargin = 2.0f;
    out.column0 = std::clamp(static_cast<int>(u0_ + kHalf - kMargin), 0, kTile - 1);
    out.column1 = std::clamp(static_cast<int>(u1_ + kHalf + kMargin), 0, kTile - 1);
    out.row0 = std::clamp(static_cast<int>(v0_ + kHalf - kMargin), 0, kTile - 1);
    out.row1 = std::clamp(static_cast<int>(v1_ + kHalf + kMargin), 0, kTile - 1);
    return out;
  }

 private:
  const RayTable::Tile& tile_;
  float det_, u0_ = 1e9f, u1_ = -1e9f, v0_ = 1e9f, v1_ = -1e9f;
  bool unknown_ = false;
};
}  // namespace

/// Draws triangles into the samples of one tile.
struct TileRaster {
  alignas(64) float depth[kSamples][kTilePixels];  ///< 1/z
  alignas(64) std::uint32_t surface[kSamples][kTilePixels];

  void clear() {
    std::fill(&depth[0][0], &depth[0][0] + kSamples * kTilePixels, 0.0f);
    std::fill(&surface[0][0], &surface[0][0] + kSamples * kTilePixels, 0u);
  }

  /// `top` are the coefficients at the tile's upper edge, `slope` their change a row (rolling shutter).
  template <bool kRolling>
  void draw(const Renderer::Coefficients& top, const Renderer::Coefficients& slope, std::uint32_t id,
            const RayTable::Tile& tile, const float* x, const float* y, int stride, const Bounds& bounds) {
    const hn::CappedTag<float, 8> d;
    const hn::RebindToUnsigned<decltype(d)> du;
    const int lanes = static_cast<int>(hn::Lanes(d));
    Renderer::Coefficients k = top;
    // What each sample's place within the pixel adds to each edge and to 1/z; constant over a row of the tile.
    float edge_at[kSamples][3], depth_at[kSamples], most[3];
    const auto place_samples = [&] {
      std::fill(most, most + 3, -1e30f);
      for (int s = 0; s < kSamples; ++s) {
        const float sx = kSampleU[s] * tile.dxdu + kSampleV[s] * tile.dxdv,
                    sy = kSampleU[s] * tile.dydu + kSampleV[s] * tile.dydv;
        for (int i = 0; i < 3; ++i) {
          edge_at[s][i] = k.e[i][0] * sx + k.e[i][1] * sy;
          most[i] = std::max(most[i], edge_at[s][i]);
        }
        depth_at[s] = k.q[0] * sx + k.q[1] * sy;
      }
    };
    if constexpr (!kRolling) place_samples();
    for (int row = bounds.row0; row <= bounds.row1; ++row) {
      if constexpr (kRolling) {
        const float f = static_cast<float>(row) + 0.5f;
        for (int i = 0; i < 3; ++i) {
          for (int j = 0; j < 3; ++j) k.e[i][j] = top.e[i][j] + f * slope.e[i][j];
          k.q[i] = top.q[i] + f * slope.q[i];
        }
        place_samples();
      }
      const auto linear = [&](const float* c, auto px, auto py) {
        return hn::MulAdd(hn::Set(d, c[0]), px, hn::MulAdd(hn::Set(d, c[1]), py, hn::Set(d, c[2])));
      };
      for (int column = bounds.column0 / lanes * lanes; column <= bounds.column1; column += lanes) {
        const auto px = hn::LoadU(d, x + row * stride + column), py = hn::LoadU(d, y + row * stride + column);
        const auto e0 = linear(k.e[0], px, py), e1 = linear(k.e[1], px, py), e2 = linear(k.e[2], px, py);
        const auto best = hn::Min(hn::Min(hn::Add(e0, hn::Set(d, most[0])), hn::Add(e1, hn::Set(d, most[1]))),
                                  hn::Add(e2, hn::Set(d, most[2])));
        if (hn::AllTrue(d, hn::Lt(best, hn::Zero(d)))) continue;
        const auto w = linear(k.q, px, py);
        const int at = row * kTile + column;
        for (int s = 0; s < kSamples; ++s) {
          const auto inside =
              hn::Min(hn::Min(hn::Add(e0, hn::Set(d, edge_at[s][0])), hn::Add(e1, hn::Set(d, edge_at[s][1]))),
                      hn::Add(e2, hn::Set(d, edge_at[s][2])));
          const auto ws = hn::Add(w, hn::Set(d, depth_at[s]));
          const auto old = hn::Load(d, &depth[s][at]);
          const auto hit = hn::And(hn::Ge(inside, hn::Zero(d)), hn::Gt(ws, old));
          hn::Store(hn::IfThenElse(hit, ws, old), d, &depth[s][at]);
          const auto ids = hn::Load(du, &surface[s][at]);
          hn::Store(hn::IfThenElse(hn::RebindMask(du, hit), hn::Set(du, id), ids), du, &surface[s][at]);
        }
      }
    }
  }
};

void Renderer::draw_tile(int column, int row) {
  TileRaster raster;
  raster.clear();
  const std::size_t index = row * rays_.columns + column;
  const RayTable::Tile& tile = rays_.tiles[index];
  const std::size_t first = row * kTile * rays_.stride + column * kTile;
  const float *x = rays_.x.data() + first, *y = rays_.y.data() + first;
  const Coefficients none{};
  for (std::uint32_t n = heads_[index]; n != kNoNode; n = nodes_[n].next) {
    const std::uint32_t t = nodes_[n].triangle;
    const Triangle& triangle = triangles_[t];
    if (rig_.readout_s <= 0) {
      BoundsFinder finder(tile);
      for (const auto& v : triangle.vertex) finder.add(v[0], v[1], v[2]);
      raster.draw<false>(coefficients_[t], none, triangle.surface, tile, x, y, rays_.stride, finder.bounds());
      continue;
    }
    // Rolling shutter: the planes at the tile's upper and lower edge, and linear between.
    Coefficients edge[2];
    BoundsFinder finder(tile);
    bool faces = true;
    const FrameSurface& surface = surfaces_[triangle.surface];
    for (int k = 0; k < 2; ++k) {
      const RowPose& pose = row_poses_[row + k];
      double v[3][3];
      for (int i = 0; i < 3; ++i) {
        double p[3];
        for (int j = 0; j < 3; ++j) p[j] = triangle.vertex[i][j] + pose.dt_s * surface.velocity[j];
        for (int j = 0; j < 3; ++j)
          v[i][j] = pose.R(j, 0) * p[0] + pose.R(j, 1) * p[1] + pose.R(j, 2) * p[2] + pose.t[j];
      }
      for (const auto& p : v) finder.add(static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2]));
      faces = coefficients(v, &edge[k]) && faces;
    }
    if (!faces) continue;
    Coefficients slope;
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) slope.e[i][j] = (edge[1].e[i][j] - edge[0].e[i][j]) / kTile;
      slope.q[i] = (edge[1].q[i] - edge[0].q[i]) / kTile;
    }
    raster.draw<true>(edge[0], slope, triangle.surface, tile, x, y, rays_.stride, finder.bounds());
  }
  shade_tile(column, row, &raster.depth[0][0], &raster.surface[0][0]);
}

}  // namespace godwit::sim
