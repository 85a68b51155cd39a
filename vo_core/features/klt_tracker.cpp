#include "vo_core/features/klt_tracker.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <hwy/highway.h>
#include <vector>

#include "hal/rt/count.h"
#include "vo_core/image/grey_noise.h"
#include "vo_core/image/patch.h"

namespace godwit::vo {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

/// Patch of edge P with what an iteration needs.
template <int P>
struct Template {
  alignas(64) std::array<float, P * P> intensity;  ///< mean removed
  alignas(64) std::array<float, P * P> gx, gy;     ///< orthogonal to the patch and to the constant
  float inv_xx = 0, inv_xy = 0, inv_yy = 0;        ///< inverse of the gradient matrix
  float mean = 1;                                  ///< removed from `intensity`, at least 1
  float norm = 0;                                  ///< length of `intensity`
  float signal = 1;                                ///< share of its variance that is not noise
  Vec2f centre = Vec2f::Zero();  ///< of the gradients' energy, from the patch's centre [px of its level]
  bool valid = false;
};

using Lanes = hn::CappedTag<float, 8>;
using Vector = hn::Vec<Lanes>;

/// Sum of the lanes in one fixed order.
float sum(Vector v) {
  alignas(64) std::array<float, 8> lanes{};
  hn::Store(v, Lanes(), lanes.data());
  float s = 0;
  for (float x : lanes) s += x;
  return s;
}

/// The W x W window whose first sample lies at (x, y) can be sampled. Written so that a NaN is refused too.
template <int W>
bool inside(const rt::ImageView& image, float x, float y) {
  return x >= 0.0f && y >= 0.0f && x + W < static_cast<float>(image.width) && y + W < static_cast<float>(image.height);
}

/// Bilinear samples of a window that lies inside.
template <int W>
void sample(const rt::ImageView& image, float x, float y, float* out) {
  const float xf = std::floor(x), yf = std::floor(y), ax = x - xf, ay = y - yf;
  for (int j = 0; j < W; ++j) {
    const std::uint8_t* row = image.row(static_cast<int>(yf) + j) + static_cast<int>(xf);
    const std::uint8_t* next = row + image.stride;
    for (int i = 0; i < W; ++i) {
      const float a = row[i], b = row[i + 1], c = next[i], d = next[i + 1];
      const float above = a + ax * (b - a), below = c + ax * (d - c);
      out[j * W + i] = above + ay * (below - above);
    }
  }
}

/// The same, handed to visit(k, v) vector by vector; v holds the samples from number k on. P: a multiple of the lanes.
template <int P, typename Visit>
void visit_samples(const rt::ImageView& image, float x, float y, const Visit& visit) {
  constexpr Lanes d;
  constexpr hn::Rebind<std::uint8_t, Lanes> d8;
  constexpr hn::Rebind<std::int32_t, Lanes> d32;
  const float xf = std::floor(x), yf = std::floor(y);
  const Vector ax = hn::Set(d, x - xf), ay = hn::Set(d, y - yf);
  const auto blend = [&](const std::uint8_t* p) {
    const Vector a = hn::ConvertTo(d, hn::PromoteTo(d32, hn::LoadU(d8, p)));
    const Vector b = hn::ConvertTo(d, hn::PromoteTo(d32, hn::LoadU(d8, p + 1)));
    return hn::MulAdd(ax, hn::Sub(b, a), a);
  };
  const int step = static_cast<int>(hn::Lanes(d));
  for (int i = 0; i < P; i += step) {
    const std::uint8_t* row = image.row(static_cast<int>(yf)) + static_cast<int>(xf) + i;
    Vector above = blend(row);
    for (int j = 0; j < P; ++j) {
      row += image.stride;
      const Vector below = blend(row);
      visit(j * P + i, hn::MulAdd(ay, hn::Sub(below, above), above));
      above = below;
    }
  }
}

template <int P>
bool make_template(const rt::ImageView& image, const Vec2f& px, float noise, float min_eigenvalue, Template<P>* t) {
  t->valid = false;
  constexpr int W = P + 2;
  constexpr float n = P * P;
  std::array<float, W * W> window;
  const float x = px.x() - P / 2 - 1, y = px.y() - P / 2 - 1;
  if (!inside<W>(image, x, y)) return false;
  sample<W>(image, x, y, window.data());
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
  constexpr int kHalf = P / 2;
  float cx = 0, cy = 0;
  for (int j = 0; j < P; ++j) {
    for (int i = 0; i < P; ++i) {
      const int k = j * P + i;
      const float energy = t->gx[k] * t->gx[k] + t->gy[k] * t->gy[k];
      cx += energy * static_cast<float>(i - kHalf);
      cy += energy * static_cast<float>(j - kHalf);
    }
  }
  const float half_trace = 0.5f * (xx + yy);
  const float smaller = half_trace - std::sqrt(0.25f * (xx - yy) * (xx - yy) + xy * xy);
  if (!(smaller > min_eigenvalue * noise * noise * n)) return false;
  const float det = xx * yy - xy * xy;
  t->inv_xx = yy / det;
  t->inv_xy = -xy / det;
  t->inv_yy = xx / det;
  t->mean = std::max(mean / n, 1.0f);
  t->norm = std::sqrt(tt);
  t->signal = std::max(0.5f, 1.0f - noise * noise * n / tt);
  t->centre = Vec2f(cx, cy) / (xx + yy);
  t->valid = true;
  return true;
}

enum class Outcome { kConverged, kNotConverged, kOutside };

/// Moves *px (of the image's level) onto the patch. Where it left the picture, *px is what it was.
template <int P>
Outcome align(const rt::ImageView& image, const Template<P>& t, int max_iterations, float converged_px, Vec2f* px) {
  constexpr Lanes d;
  const Vec2f start = *px;
  for (int iteration = 0; iteration < max_iterations; ++iteration) {
    const float x = px->x() - P / 2, y = px->y() - P / 2;
    if (!inside<P>(image, x, y)) {
      *px = start;
      return Outcome::kOutside;
    }
    Vector sx = hn::Zero(d), sy = hn::Zero(d);
    Vector s = hn::Zero(d);
    visit_samples<P>(image, x, y, [&](int k, Vector v) {
      sx = hn::MulAdd(hn::Load(d, &t.gx[k]), v, sx);
      sy = hn::MulAdd(hn::Load(d, &t.gy[k]), v, sy);
      s = hn::Add(s, v);
    });
    // In more light the gradients are larger as the patch is brighter, and steps would overshoot; in less they are only
    // short. What is sharper without more light was blurred in the reference, whose corners then lie beside the true
    // ones: such a track had better not converge.
    const float gain = std::clamp(sum(s) / (P * P) / t.mean, 1.0f, kMaxGain);
    const float bx = sum(sx) / gain, by = sum(sy) / gain;
    const Vec2f step(t.inv_xx * bx + t.inv_xy * by, t.inv_xy * bx + t.inv_yy * by);
    *px -= step;
    if (!((*px - start).squaredNorm() < static_cast<float>(P * P))) return Outcome::kNotConverged;
    if (step.squaredNorm() < converged_px * converged_px) return Outcome::kConverged;
  }
  return Outcome::kNotConverged;
}

template <int P>
float correlation(const rt::ImageView& image, const Template<P>& t, const Vec2f& px) {
  constexpr Lanes d;
  const float x = px.x() - P / 2, y = px.y() - P / 2;
  if (!inside<P>(image, x, y)) return -1.0f;
  Vector s = hn::Zero(d), ss = hn::Zero(d), st = hn::Zero(d);
  visit_samples<P>(image, x, y, [&](int k, Vector v) {
    s = hn::Add(s, v);
    ss = hn::MulAdd(v, v, ss);
    st = hn::MulAdd(hn::Load(d, &t.intensity[k]), v, st);
  });
  const float mean = sum(s) / (P * P);
  const float variance = sum(ss) - mean * mean * (P * P);
  if (variance < 1.0f) return -1.0f;
  return sum(st) / (std::sqrt(variance) * t.norm);
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
    const int finest = track->level;
    for (int level = std::min(picture.levels, kLevels) - 1; level > finest; --level) {
      const auto& t = patch.coarse[level - 1];
      if (!t.valid) continue;
      Vec2f p = to_level(px, level);
      const Vec2f before = p;
      // A coarse level that fails teaches nothing; the finer ones start from where it started.
      if (align(picture.level[level], t, options.max_iterations, 2 * options.converged_px, &p) != Outcome::kConverged ||
          (p - before).squaredNorm() > 36.0f)
        continue;
      px = from_level(p, level);
    }
    const rt::ImageView& image = picture.level[finest];
    Vec2f p = to_level(px, finest);
    if (align(image, patch.fine, options.max_iterations, options.converged_px, &p) != Outcome::kConverged) return false;
    px = from_level(p, finest);
    if ((px - track->px).squaredNorm() > options.max_jump_px * options.max_jump_px) return false;
    track->correlation = correlation(image, patch.fine, p);
    if (track->correlation < options.min_correlation * patch.fine.signal) return false;
    track->px = px;
    return true;
  }
};

KltTracker::KltTracker(const KltOptions& options) : impl_(std::make_unique<Impl>()) {
  impl_->options = options;
}
KltTracker::~KltTracker() = default;

int KltTracker::set_reference(const rt::PyramidView& reference, std::span<const Vec2f> px, float grey_noise) {
  Impl& m = *impl_;
  m.count = std::min(rt::count_of(px), kMaxTracks);
  int alive = 0;
  for (int i = 0; i < m.count; ++i) {
    const Vec2f& p = px[i];
    Impl::Patches& patch = m.patches[i];
    KltTrack& track = m.tracks[i];
    track = KltTrack{.px_ref = p, .px = p};
    for (int level = 0; level < std::min(kFineLevels, reference.levels) && !track.alive; ++level) {
      track.level = level;
      track.alive = make_template(reference.level[level], to_level(p, level), grey_noise_at(grey_noise, level),
                                  m.options.min_eigenvalue, &patch.fine);
    }
    if (track.alive) track.centre = patch.fine.centre * level_scale(track.level);
    for (int level = 1; level < kLevels; ++level) {
      auto& t = patch.coarse[level - 1];
      t.valid = false;
      if (level < reference.levels)
        make_template(reference.level[level], to_level(p, level), grey_noise_at(grey_noise, level),
                      m.options.min_eigenvalue, &t);
    }
    alive += track.alive ? 1 : 0;
  }
  return alive;
}

int KltTracker::track(const rt::PyramidView& picture) {
  Impl& m = *impl_;
  int alive = 0;
  for (int i = 0; i < m.count; ++i) {
    KltTrack& track = m.tracks[i];
    if (track.alive) track.alive = m.find(picture, m.patches[i], &track);
    alive += track.alive ? 1 : 0;
  }
  return alive;
}

std::span<const KltTrack> KltTracker::tracks() const {
  return std::span(impl_->tracks).first(impl_->count);
}

void KltTracker::drop(int index) {
  impl_->tracks[index].alive = false;
}

}  // namespace godwit::vo
