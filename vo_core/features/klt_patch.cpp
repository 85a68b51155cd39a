#include "vo_core/features/klt_patch.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <hwy/highway.h>

#include "vo_core/image/patch.h"

namespace godwit::vo::klt {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

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

/// Bilinear samples of a window whose steps are `right` and `down`, the one of number W / 2 at px. False if it leaves
/// the picture. Places in 1 / 65536 px.
template <int W>
bool sample_warped(const rt::ImageView& image, const Vec2f& px, const Vec2f& right, const Vec2f& down, float* out) {
  constexpr float kOne = 65536.0f;
  const Vec2f origin = px - (W / 2) * (right + down);
  const auto in_picture = [&](const Vec2f& p) {
    return p.x() >= 1.0f && p.y() >= 1.0f && p.x() < static_cast<float>(image.width - 2) &&
           p.y() < static_cast<float>(image.height - 2);
  };
  for (const Vec2f& corner : {Vec2f(0, 0), Vec2f(W - 1, 0), Vec2f(0, W - 1), Vec2f(W - 1, W - 1)})
    if (!in_picture(origin + corner.x() * right + corner.y() * down)) return false;
  const auto fixed = [&](float v) { return static_cast<std::int32_t>(v * kOne); };
  const std::int32_t step_x = fixed(right.x()), step_y = fixed(right.y());
  for (int j = 0; j < W; ++j) {
    const Vec2f first = origin + static_cast<float>(j) * down;
    std::int32_t x = fixed(first.x()), y = fixed(first.y());
    for (int i = 0; i < W; ++i, x += step_x, y += step_y) {
      const std::uint8_t* row = image.row(y >> 16) + (x >> 16);
      const std::uint8_t* next = row + image.stride;
      const float ax = static_cast<float>(x & 0xffff) / kOne, ay = static_cast<float>(y & 0xffff) / kOne;
      const float a = row[0], b = row[1], c = next[0], e = next[1];
      const float above = a + ax * (b - a), below = c + ax * (e - c);
      out[j * W + i] = above + ay * (below - above);
    }
  }
  return true;
}

}  // namespace

template <int P>
bool make_template(const rt::ImageView& image, const Vec2f& px, const Eigen::Matrix2f& warp, float noise,
                   float min_eigenvalue, Template<P>* t) {
  t->valid = false;
  constexpr int W = P + 2;
  constexpr float n = P * P;
  constexpr Lanes d;
  const int step = static_cast<int>(hn::Lanes(d));
  std::array<float, W * W> window;
  if (warp.isIdentity()) {
    const float x = px.x() - P / 2 - 1, y = px.y() - P / 2 - 1;
    if (!inside<W>(image, x, y)) return false;
    sample<W>(image, x, y, window.data());
  } else {
    const Eigen::Matrix2f back = warp.inverse();
    if (!sample_warped<W>(image, px, back.col(0), back.col(1), window.data())) return false;
  }
  const Vector half = hn::Set(d, 0.5f);
  Vector s = hn::Zero(d), sx = hn::Zero(d), sy = hn::Zero(d);
  for (int j = 0; j < P; ++j) {
    for (int i = 0; i < P; i += step) {
      const float* c = &window[(j + 1) * W + i + 1];
      const int k = j * P + i;
      const Vector grey = hn::LoadU(d, c);
      const Vector gx = hn::Mul(half, hn::Sub(hn::LoadU(d, c + 1), hn::LoadU(d, c - 1)));
      const Vector gy = hn::Mul(half, hn::Sub(hn::LoadU(d, c + W), hn::LoadU(d, c - W)));
      hn::Store(grey, d, &t->intensity[k]);
      hn::Store(gx, d, &t->gx[k]);
      hn::Store(gy, d, &t->gy[k]);
      s = hn::Add(s, grey);
      sx = hn::Add(sx, gx);
      sy = hn::Add(sy, gy);
    }
  }
  const float mean = sum(s) / n;
  const Vector m = hn::Set(d, mean), mx = hn::Set(d, sum(sx) / n), my = hn::Set(d, sum(sy) / n);
  s = sx = sy = hn::Zero(d);
  for (int k = 0; k < P * P; k += step) {
    const Vector grey = hn::Sub(hn::Load(d, &t->intensity[k]), m);
    const Vector gx = hn::Sub(hn::Load(d, &t->gx[k]), mx), gy = hn::Sub(hn::Load(d, &t->gy[k]), my);
    hn::Store(grey, d, &t->intensity[k]);
    hn::Store(gx, d, &t->gx[k]);
    hn::Store(gy, d, &t->gy[k]);
    s = hn::MulAdd(grey, grey, s);
    sx = hn::MulAdd(grey, gx, sx);
    sy = hn::MulAdd(grey, gy, sy);
  }
  const float tt = sum(s);
  if (!(tt >= 1.0f)) return false;
  const Vector tx = hn::Set(d, sum(sx) / tt), ty = hn::Set(d, sum(sy) / tt);
  Vector sxx = hn::Zero(d), sxy = hn::Zero(d), syy = hn::Zero(d), sex = hn::Zero(d), sey = hn::Zero(d);
  for (int j = 0; j < P; ++j) {
    const Vector down = hn::Set(d, static_cast<float>(j - P / 2));
    for (int i = 0; i < P; i += step) {
      const int k = j * P + i;
      const Vector grey = hn::Load(d, &t->intensity[k]);
      const Vector gx = hn::NegMulAdd(tx, grey, hn::Load(d, &t->gx[k]));
      const Vector gy = hn::NegMulAdd(ty, grey, hn::Load(d, &t->gy[k]));
      hn::Store(gx, d, &t->gx[k]);
      hn::Store(gy, d, &t->gy[k]);
      const Vector xx = hn::Mul(gx, gx), yy = hn::Mul(gy, gy), energy = hn::Add(xx, yy);
      sxx = hn::Add(sxx, xx);
      syy = hn::Add(syy, yy);
      sxy = hn::MulAdd(gx, gy, sxy);
      sex = hn::MulAdd(energy, hn::Iota(d, i - P / 2), sex);
      sey = hn::MulAdd(energy, down, sey);
    }
  }
  const float xx = sum(sxx), xy = sum(sxy), yy = sum(syy);
  const float half_trace = 0.5f * (xx + yy);
  const float smaller = half_trace - std::sqrt(0.25f * (xx - yy) * (xx - yy) + xy * xy);
  if (!(smaller > min_eigenvalue * noise * noise * n)) return false;
  const float det = xx * yy - xy * xy;
  t->inv_xx = yy / det;
  t->inv_xy = -xy / det;
  t->inv_yy = xx / det;
  t->mean = std::max(mean, 1.0f);
  t->norm = std::sqrt(tt);
  t->signal = std::max(0.5f, 1.0f - noise * noise * n / tt);
  t->centre = Vec2f(sum(sex), sum(sey)) / (xx + yy);
  t->valid = true;
  return true;
}

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

template bool make_template<8>(const rt::ImageView&, const Vec2f&, const Eigen::Matrix2f&, float, float, Template<8>*);
template Outcome align<8>(const rt::ImageView&, const Template<8>&, int, float, Vec2f*);
template float correlation<8>(const rt::ImageView&, const Template<8>&, const Vec2f&);
template bool make_template<16>(const rt::ImageView&, const Vec2f&, const Eigen::Matrix2f&, float, float,
                                Template<16>*);
template Outcome align<16>(const rt::ImageView&, const Template<16>&, int, float, Vec2f*);
template float correlation<16>(const rt::ImageView&, const Template<16>&, const Vec2f&);

}  // namespace godwit::vo::klt
