#include "vo_core/klt_tracker.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace godwit::vo {
namespace {

/// Patch of edge P with what an iteration needs.
template <int P>
struct Template {
  alignas(64) std::array<float, P * P> intensity;  ///< mean removed
  alignas(64) std::array<float, P * P> gx, gy;     ///< orthogonal to the patch and to the constant
  float inv_xx = 0, inv_xy = 0, inv_yy = 0;        ///< inverse of the gradient matrix
  float norm = 0;                                  ///< length of `intensity`
  bool valid = false;
};

/// Sum of the lanes in one fixed order: the same result whatever the vector width.
template <int P>
float sum(const std::array<float, P>& lanes) {
  float s = 0;
  for (float v : lanes) s += v;
  return s;
}

/// Level-0 pixel to the pixel of a level and back (rt::PyramidView's centre convention).
Vec2f to_level(const Vec2f& px, int level) {
  const float s = 1.0f / static_cast<float>(1 << level);
  return (px.array() + 0.5f) * s - 0.5f;
}
Vec2f from_level(const Vec2f& px, int level) {
  const float s = static_cast<float>(1 << level);
  return (px.array() + 0.5f) * s - 0.5f;
}

/// Bilinear samples of a W x W window whose first sample lies at (x, y). False if it leaves the picture.
template <int W>
bool sample(const rt::ImageView& image, float x, float y, float* out) {
  const float xf = std::floor(x), yf = std::floor(y);
  // Written so that a NaN is refused too.
  if (!(xf >= 0.0f && yf >= 0.0f && xf + W < static_cast<float>(image.width) &&
        yf + W < static_cast<float>(image.height)))
    return false;
  const float ax = x - xf, ay = y - yf;
  const std::uint8_t* row = image.row(static_cast<int>(yf)) + static_cast<int>(xf);
  alignas(64) float above[W], below[W];
  for (int i = 0; i < W; ++i) {
    const float a = row[i], b = row[i + 1];
    above[i] = a + ax * (b - a);
  }
  for (int j = 0; j < W; ++j) {
    row += image.stride;
    for (int i = 0; i < W; ++i) {
      const float a = row[i], b = row[i + 1];
      below[i] = a + ax * (b - a);
    }
    for (int i = 0; i < W; ++i) {
      out[j * W + i] = above[i] + ay * (below[i] - above[i]);
      above[i] = below[i];
    }
  }
  return true;
}

template <int P>
bool make_template(const rt::ImageView& image, const Vec2f& px, float min_eigenvalue, Template<P>* t) {
  t->valid = false;
  constexpr int W = P + 2;
  constexpr float n = P * P;
  std::array<float, W * W> window;
  if (!sample<W>(image, px.x() - P / 2 - 1, px.y() - P / 2 - 1, window.data())) return false;
  float mean = 0, mean_x = 0, mean_y = 0;
  for (int j = 0; j < P; ++j) {
    for (int i = 0; i < P; ++i) {
      const float* c = &window[(j + 1) * W + i + 1];
      const int k = j * P + i;
      t->intensity[k] = c[0];
      t->gx[k] = 0.5f * (c[1] - c[-1]);
      t->gy[k] = 0.5f * (c[W] - c[-W]);
      mean += t->intensity[k];
      mean_x += t->gx[k];
      mean_y += t->gy[k];
    }
  }
  float tt = 0, tx = 0, ty = 0;
  for (int k = 0; k < P * P; ++k) {
    t->intensity[k] -= mean / n;
    t->gx[k] -= mean_x / n;
    t->gy[k] -= mean_y / n;
    tt += t->intensity[k] * t->intensity[k];
    tx += t->intensity[k] * t->gx[k];
    ty += t->intensity[k] * t->gy[k];
  }
  if (tt < 1.0f) return false;
  float xx = 0, xy = 0, yy = 0;
  for (int k = 0; k < P * P; ++k) {
    t->gx[k] -= tx / tt * t->intensity[k];
    t->gy[k] -= ty / tt * t->intensity[k];
    xx += t->gx[k] * t->gx[k];
    xy += t->gx[k] * t->gy[k];
    yy += t->gy[k] * t->gy[k];
  }
  const float half_trace = 0.5f * (xx + yy);
  const float smaller = half_trace - std::sqrt(0.25f * (xx - yy) * (xx - yy) + xy * xy);
  if (!(smaller > min_eigenvalue * n)) return false;
  const float det = xx * yy - xy * xy;
  t->inv_xx = yy / det;
  t->inv_xy = -xy / det;
  t->inv_yy = xx / det;
  t->norm = std::sqrt(tt);
  t->valid = true;
  return true;
}

enum class Outcome { kConverged, kNotConverged, kOutside };

/// Moves *px (of the image's level) onto the patch. Where it left the picture, *px is what it was.
template <int P>
Outcome align(const rt::ImageView& image, const Template<P>& t, int max_iterations, float converged_px, Vec2f* px) {
  alignas(64) std::array<float, P * P> patch;
  const Vec2f start = *px;
  for (int iteration = 0; iteration < max_iterations; ++iteration) {
    if (!sample<P>(image, px->x() - P / 2, px->y() - P / 2, patch.data())) {
      *px = start;
      return Outcome::kOutside;
    }
    alignas(64) std::array<float, P> sx{}, sy{};
    for (int j = 0; j < P; ++j) {
      for (int i = 0; i < P; ++i) {
        const int k = j * P + i;
        sx[i] += t.gx[k] * patch[k];
        sy[i] += t.gy[k] * patch[k];
      }
    }
    const float bx = sum<P>(sx), by = sum<P>(sy);
    const Vec2f step(t.inv_xx * bx + t.inv_xy * by, t.inv_xy * bx + t.inv_yy * by);
    *px -= step;
    if (!((*px - start).squaredNorm() < static_cast<float>(P * P))) return Outcome::kNotConverged;
    if (step.squaredNorm() < converged_px * converged_px) return Outcome::kConverged;
  }
  return Outcome::kNotConverged;
}

template <int P>
float correlation(const rt::ImageView& image, const Template<P>& t, const Vec2f& px) {
  alignas(64) std::array<float, P * P> patch;
  if (!sample<P>(image, px.x() - P / 2, px.y() - P / 2, patch.data())) return -1.0f;
  alignas(64) std::array<float, P> s{}, ss{}, st{};
  for (int j = 0; j < P; ++j) {
    for (int i = 0; i < P; ++i) {
      const int k = j * P + i;
      s[i] += patch[k];
      ss[i] += patch[k] * patch[k];
      st[i] += patch[k] * t.intensity[k];
    }
  }
  const float mean = sum<P>(s) / (P * P);
  const float variance = sum<P>(ss) - mean * mean * (P * P);
  if (variance < 1.0f) return -1.0f;
  return sum<P>(st) / (std::sqrt(variance) * t.norm);
}

}  // namespace

struct KltTracker::Impl {
  struct Patches {
    Template<kFinePatch> fine;
    std::array<Template<kCoarsePatch>, kLevels - 1> coarse;
  };
  KltOptions options;
  int count = 0;
  std::vector<KltTrack> tracks = std::vector<KltTrack>(kMaxTracks);
  std::vector<Patches> patches = std::vector<Patches>(kMaxTracks);

  bool find(const rt::PyramidView& picture, const Patches& patch, KltTrack* track) const {
    Vec2f px = track->px;
    for (int level = std::min(picture.levels, kLevels) - 1; level > 0; --level) {
      const auto& t = patch.coarse[static_cast<std::size_t>(level - 1)];
      if (!t.valid) continue;
      Vec2f p = to_level(px, level);
      const Vec2f before = p;
      // A coarse level that fails teaches nothing; the finer ones start from where it started.
      if (align(picture.level[static_cast<std::size_t>(level)], t, options.max_iterations, 2 * options.converged_px,
                &p) != Outcome::kConverged ||
          (p - before).squaredNorm() > 36.0f)
        continue;
      px = from_level(p, level);
    }
    if (align(picture.level[0], patch.fine, options.max_iterations, options.converged_px, &px) != Outcome::kConverged)
      return false;
    if ((px - track->px).squaredNorm() > options.max_jump_px * options.max_jump_px) return false;
    track->correlation = correlation(picture.level[0], patch.fine, px);
    if (track->correlation < options.min_correlation) return false;
    track->px = px;
    return true;
  }
};

KltTracker::KltTracker(const KltOptions& options) : impl_(std::make_unique<Impl>()) {
  impl_->options = options;
}
KltTracker::~KltTracker() = default;

int KltTracker::set_reference(const rt::PyramidView& reference, std::span<const Vec2f> px) {
  Impl& m = *impl_;
  m.count = static_cast<int>(std::min<std::size_t>(px.size(), kMaxTracks));
  int alive = 0;
  for (int i = 0; i < m.count; ++i) {
    const Vec2f& p = px[static_cast<std::size_t>(i)];
    Impl::Patches& patch = m.patches[static_cast<std::size_t>(i)];
    KltTrack& track = m.tracks[static_cast<std::size_t>(i)];
    track = {p, p, 1.0f, make_template(reference.level[0], p, m.options.min_eigenvalue, &patch.fine)};
    for (int level = 1; level < kLevels; ++level) {
      auto& t = patch.coarse[static_cast<std::size_t>(level - 1)];
      t.valid = false;
      if (level < reference.levels)
        make_template(reference.level[static_cast<std::size_t>(level)], to_level(p, level), m.options.min_eigenvalue,
                      &t);
    }
    alive += track.alive ? 1 : 0;
  }
  return alive;
}

int KltTracker::track(const rt::PyramidView& picture) {
  Impl& m = *impl_;
  int alive = 0;
  for (int i = 0; i < m.count; ++i) {
    KltTrack& track = m.tracks[static_cast<std::size_t>(i)];
    if (track.alive) track.alive = m.find(picture, m.patches[static_cast<std::size_t>(i)], &track);
    alive += track.alive ? 1 : 0;
  }
  return alive;
}

std::span<const KltTrack> KltTracker::tracks() const {
  return {impl_->tracks.data(), static_cast<std::size_t>(impl_->count)};
}

void KltTracker::drop(int index) {
  impl_->tracks[static_cast<std::size_t>(index)].alive = false;
}

}  // namespace godwit::vo
