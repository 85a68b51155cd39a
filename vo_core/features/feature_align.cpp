#include "vo_core/features/feature_align.h"

#include <Eigen/LU>
#include <array>

#include "vo_core/image/patch.h"

namespace godwit::vo {
namespace {

constexpr float kConvergedPx = 0.015f;
constexpr float kMinContrast = 2.5f;  // grey levels rms: below, noise decides where the patch lies

// Parameters: shift along `dims` directions, then gain and offset of the brightness.
template <int kDims>
bool prepare(const ReferencePatch& ref, const Vec2f& direction, AlignTemplate* prepared) {
  constexpr int kN = kDims + 2;
  const RowTag df;
  constexpr int kLanes = static_cast<int>(hn::MaxLanes(RowTag()));
  float* const value = prepared->value.data();
  float* const g0 = prepared->g0.data();
  float* const g1 = prepared->g1.data();

  const auto half = hn::Set(df, 0.5f), along_x = hn::Set(df, direction.x()), along_y = hn::Set(df, direction.y());
  auto sum_of_values = hn::Zero(df);
  for (int y = 0; y < kPatchSize; ++y) {
    for (int q = 0; q < kPatchSize; q += kLanes) {
      const float* w = ref.value.data() + (y + 1) * kPatchBorderSize + 1 + q;
      const auto v = hn::LoadU(df, w);
      const auto gx = hn::Mul(half, hn::Sub(hn::LoadU(df, w + 1), hn::LoadU(df, w - 1)));
      const auto gy = hn::Mul(half, hn::Sub(hn::LoadU(df, w + kPatchBorderSize), hn::LoadU(df, w - kPatchBorderSize)));
      const int k = y * kPatchSize + q;
      hn::Store(v, df, value + k);
      sum_of_values = hn::Add(v, sum_of_values);
      if constexpr (kDims == 2) {
        hn::Store(gx, df, g0 + k);
        hn::Store(gy, df, g1 + k);
      } else {
        hn::Store(hn::MulAdd(gx, along_x, hn::Mul(gy, along_y)), df, g0 + k);
      }
    }
  }
  const float mean = hn::GetLane(hn::SumOfLanes(df, sum_of_values)) / 64.0f;
  Eigen::Matrix<float, kN, kN> H = Eigen::Matrix<float, kN, kN>::Zero();
  {
    auto s00 = hn::Zero(df), s01 = s00, s11 = s00, s0i = s00, s1i = s00, s0 = s00, s1 = s00, sii = s00;
    const auto vm = hn::Set(df, mean);
    for (int k = 0; k < 64; k += kLanes) {
      const auto v = hn::Sub(hn::Load(df, value + k), vm);
      hn::Store(v, df, value + k);  // from here on the reference is centred
      const auto a = hn::Load(df, g0 + k);
      s00 = hn::MulAdd(a, a, s00);
      s0i = hn::MulAdd(a, v, s0i);
      s0 = hn::Add(a, s0);
      sii = hn::MulAdd(v, v, sii);
      if constexpr (kDims == 2) {
        const auto c = hn::Load(df, g1 + k);
        s01 = hn::MulAdd(a, c, s01);
        s11 = hn::MulAdd(c, c, s11);
        s1i = hn::MulAdd(c, v, s1i);
        s1 = hn::Add(c, s1);
      }
    }
    const auto sum = [&](auto v) { return hn::GetLane(hn::SumOfLanes(df, v)); };
    H(0, 0) = sum(s00);
    H(0, kDims) = sum(s0i);
    H(0, kDims + 1) = sum(s0);
    if constexpr (kDims == 2) {
      H(0, 1) = sum(s01);
      H(1, 1) = sum(s11);
      H(1, kDims) = sum(s1i);
      H(1, kDims + 1) = sum(s1);
    }
    H(kDims, kDims) = sum(sii);
    H(kDims + 1, kDims + 1) = 64.0f;
    H.template triangularView<Eigen::StrictlyLower>() = H.transpose();
  }
  const float contrast = std::sqrt(H(kDims, kDims) / 64.0f);
  if (contrast < kMinContrast) return false;
  Eigen::Matrix<float, kN, kN> H_inv;
  bool invertible = false;
  H.computeInverseWithCheck(H_inv, invertible, 1e-6f);
  if (!invertible || !H_inv.allFinite()) return false;
  Eigen::Map<Eigen::Matrix<float, kN, kN>>(prepared->H_inv.data()) = H_inv;
  prepared->mean = mean;
  prepared->contrast = contrast;
  prepared->direction = direction;
  return true;
}

template <int kDims>
FeatureAlignResult align_dims(const rt::ImageView& image, const AlignTemplate& prepared, int max_iterations,
                              float max_shift_px, Vec2f* px) {
  constexpr int kN = kDims + 2;
  const RowTag df;
  constexpr int kLanes = static_cast<int>(hn::MaxLanes(RowTag()));
  const float* const value = prepared.value.data();
  const float* const g0 = prepared.g0.data();
  const float* const g1 = prepared.g1.data();
  const Eigen::Matrix<float, kN, kN> H_inv = Eigen::Map<const Eigen::Matrix<float, kN, kN>>(prepared.H_inv.data());
  FeatureAlignResult result;
  Vec2f p = *px;
  float gain = 1.0f, offset = prepared.mean;
  for (int it = 0; it < max_iterations; ++it) {
    if (!window_inside(image, p, kPatchHalf, kPatchHalf + 1)) return result;
    const float sx = p.x() - kPatchHalf, sy = p.y() - kPatchHalf;
    const int xi = static_cast<int>(sx), yi = static_cast<int>(sy);
    const auto fx = hn::Set(df, sx - static_cast<float>(xi)), fy = hn::Set(df, sy - static_cast<float>(yi));
    const auto vg = hn::Set(df, gain), vo = hn::Set(df, offset);
    auto srr = hn::Zero(df), s0 = srr, s1 = srr, si = srr, so = srr;
    for (int q = 0; q < kPatchSize; q += kLanes) {
      const std::uint8_t* row = image.row(yi) + xi + q;
      auto a = load_row(row);
      auto above = hn::MulAdd(fx, hn::Sub(load_row(row + 1), a), a);
      for (int y = 0; y < kPatchSize; ++y) {
        row += image.stride;
        a = load_row(row);
        const auto below = hn::MulAdd(fx, hn::Sub(load_row(row + 1), a), a);
        const auto now = hn::MulAdd(fy, hn::Sub(below, above), above);
        above = below;
        const int k = y * kPatchSize + q;
        const auto v = hn::Load(df, value + k);
        const auto r = hn::Sub(now, hn::MulAdd(vg, v, vo));
        srr = hn::MulAdd(r, r, srr);
        s0 = hn::MulAdd(r, hn::Load(df, g0 + k), s0);
        if constexpr (kDims == 2) s1 = hn::MulAdd(r, hn::Load(df, g1 + k), s1);
        si = hn::MulAdd(r, v, si);
        so = hn::Add(r, so);
      }
    }
    const hn::FixedTag<float, 4> d4;
    alignas(16) std::array<float, 4> sums;
    float rr;
    if constexpr (kDims == 2) {
      hn::Store(sums_of_lanes(s0, s1, si, so), d4, sums.data());
      rr = hn::GetLane(hn::SumOfLanes(df, srr));
    } else {
      hn::Store(sums_of_lanes(s0, si, so, srr), d4, sums.data());
      rr = sums[3];
    }
    const Eigen::Map<const Eigen::Matrix<float, kN, 1>> b(sums.data());
    const Eigen::Matrix<float, kN, 1> x = H_inv * b;
    // The reference moved by x matches the picture here, so the picture's patch lies x further back.
    const float g = std::max(gain, 1 / kMaxGain);
    Vec2f step;
    if constexpr (kDims == 2)
      step = Vec2f(x(0), x(1)) / g;
    else
      step = x(0) / g * prepared.direction;
    // Residual that is left when this step is taken: r^T r - b^T x.
    const float left = std::max(rr - b.dot(x), 0.0f);
    gain += x(kDims);
    offset += x(kDims + 1);
    p -= step;
    if ((p - *px).squaredNorm() > max_shift_px * max_shift_px) return result;
    if (step.squaredNorm() < kConvergedPx * kConvergedPx) {
      result.converged = gain > 1 / kMaxGain && gain < kMaxGain;
      result.residual = std::sqrt(left / 64.0f) / (prepared.contrast * std::max(gain, 1 / kMaxGain));
      result.gain = gain;
      *px = p;
      return result;
    }
  }
  return result;
}

}  // namespace

bool prepare_align_2d(const ReferencePatch& ref, AlignTemplate* prepared) {
  return prepare<2>(ref, Vec2f::Zero(), prepared);
}

bool prepare_align_1d(const ReferencePatch& ref, const Vec2f& direction, AlignTemplate* prepared) {
  return prepare<1>(ref, direction, prepared);
}

FeatureAlignResult align(const rt::ImageView& image, const AlignTemplate& prepared, int max_iterations,
                         float max_shift_px, Vec2f* px) {
  return prepared.direction.isZero(0.0f) ? align_dims<2>(image, prepared, max_iterations, max_shift_px, px)
                                         : align_dims<1>(image, prepared, max_iterations, max_shift_px, px);
}

}  // namespace godwit::vo
