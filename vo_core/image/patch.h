// Square picture patches: bilinear sampling with SIMD. Header-only, inlined into the stages that need it.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <hwy/highway.h>

#include "hal/rt/image.h"
#include "vo_core/geometry/geometry.h"
#include "vo_core/image/levels.h"

namespace godwit::vo {

namespace hn = hwy::HWY_NAMESPACE;

/// How much brighter a patch may be than where it was first seen, and its inverse: more is another patch.
inline constexpr float kMaxGain = 5.0f;

/// Four neighbouring pixels as floats.
inline hn::Vec<hn::FixedTag<float, 4>> load4(const std::uint8_t* p) {
  const hn::FixedTag<std::uint8_t, 4> du8;
  const hn::FixedTag<std::int32_t, 4> di32;
  const hn::FixedTag<float, 4> df;
  return hn::ConvertTo(df, hn::PromoteTo(di32, hn::LoadU(du8, p)));
}

/// Tag of the widest vector, up to 8 floats, used for 8-pixel rows (8 lanes on AVX2, 4 on NEON).
using RowTag = hn::CappedTag<float, 8>;

inline hn::Vec<RowTag> load_row(const std::uint8_t* p) {
  const RowTag df;
  const hn::Rebind<std::uint8_t, RowTag> du8;
  const hn::Rebind<std::int32_t, RowTag> di32;
  return hn::ConvertTo(df, hn::PromoteTo(di32, hn::LoadU(du8, p)));
}

/// The sums of four vectors' lanes, side by side. D: RowTag.
template <typename D = RowTag>
hn::Vec<hn::FixedTag<float, 4>> sums_of_lanes(hn::Vec<D> a, hn::Vec<D> b, hn::Vec<D> c, hn::Vec<D> d) {
  const D df;
  const auto ac = hn::Add(hn::InterleaveLower(df, a, c), hn::InterleaveUpper(df, a, c));
  const auto bd = hn::Add(hn::InterleaveLower(df, b, d), hn::InterleaveUpper(df, b, d));
  const auto abcd = hn::Add(hn::InterleaveLower(df, ac, bd), hn::InterleaveUpper(df, ac, bd));
  if constexpr (hn::MaxLanes(D()) == 8) {
    const hn::FixedTag<float, 4> half;
    return hn::Add(hn::LowerHalf(half, abcd), hn::UpperHalf(half, abcd));
  } else {
    return abcd;
  }
}

/// Bilinear values at one (x, y) a lane. Precondition of each: 0 <= x < width - 1, 0 <= y < height - 1.
inline hn::Vec<RowTag> interpolate_lanes(const rt::ImageView& im, hn::Vec<RowTag> x, hn::Vec<RowTag> y) {
  const RowTag df;
  const hn::Rebind<std::int32_t, RowTag> di32;
  const auto xi = hn::ConvertTo(di32, x), yi = hn::ConvertTo(di32, y);
  const auto fx = hn::Sub(x, hn::ConvertTo(df, xi)), fy = hn::Sub(y, hn::ConvertTo(df, yi));
  // Four bytes from each pixel on, of which two count; image.h promises that they can be read. Read one by one: a
  // gather is no faster (godwit-yardstick), and QEMU 7.2 takes another register for ymm4 where that holds a gather's
  // offsets.
  constexpr std::size_t kLanes = hn::MaxLanes(df);
  alignas(32) std::array<std::int32_t, kLanes> at, above_px, below_px;
  hn::Store(hn::Add(hn::Mul(yi, hn::Set(di32, im.stride)), xi), di32, at.data());
  for (std::size_t i = 0; i < kLanes; ++i) {
    const std::uint8_t* const p = im.data + at[i];
    std::memcpy(&above_px[i], p, sizeof above_px[i]);
    std::memcpy(&below_px[i], p + im.stride, sizeof below_px[i]);
  }
  const auto top = hn::Load(di32, above_px.data()), bottom = hn::Load(di32, below_px.data());
  const auto byte = hn::Set(di32, 0xff);
  const auto left = [&](auto four) { return hn::ConvertTo(df, hn::And(four, byte)); };
  const auto right = [&](auto four) { return hn::ConvertTo(df, hn::And(hn::ShiftRight<8>(four), byte)); };
  const auto above = hn::MulAdd(fx, hn::Sub(right(top), left(top)), left(top));
  const auto below = hn::MulAdd(fx, hn::Sub(right(bottom), left(bottom)), left(bottom));
  return hn::MulAdd(fy, hn::Sub(below, above), above);
}

/// Samples `rows` rows of 4 * quads pixels spaced by 1, top-left sample at (x, y), into out (row length 4 * quads).
/// Precondition: the samples and their right and lower neighbours lie in the picture.
inline void sample_grid(const rt::ImageView& im, float x, float y, int quads, int rows, float* out) {
  const hn::FixedTag<float, 4> df;
  const int xi = static_cast<int>(std::floor(x)), yi = static_cast<int>(std::floor(y));
  const auto fx = hn::Set(df, x - static_cast<float>(xi));
  const auto fy = hn::Set(df, y - static_cast<float>(yi));
  for (int q = 0; q < quads; ++q) {
    const std::uint8_t* p = im.row(yi) + xi + 4 * q;
    auto a = load4(p);
    auto above = hn::MulAdd(fx, hn::Sub(load4(p + 1), a), a);
    for (int r = 0; r < rows; ++r) {
      p += im.stride;
      a = load4(p);
      const auto below = hn::MulAdd(fx, hn::Sub(load4(p + 1), a), a);
      hn::StoreU(hn::MulAdd(fy, hn::Sub(below, above), above), df, out + (r * quads + q) * 4);
      above = below;
    }
  }
}

/// Samples 4 x 4 pixels spaced by 1, top-left sample at (x, y), row by row, as many rows a vector as it holds. D:
/// RowTag. Precondition: as of sample_grid().
template <typename D = RowTag>
std::array<hn::Vec<D>, 16 / hn::MaxLanes(D())> sample_4x4(const rt::ImageView& im, float x, float y) {
  const hn::FixedTag<float, 4> d4;
  const D df;
  const int xi = static_cast<int>(std::floor(x)), yi = static_cast<int>(std::floor(y));
  const auto fx = hn::Set(d4, x - static_cast<float>(xi));
  const auto fy = hn::Set(df, y - static_cast<float>(yi));
  const std::uint8_t* p = im.row(yi) + xi;
  std::array<hn::Vec<hn::FixedTag<float, 4>>, 5> row;
  for (int r = 0; r < 5; ++r, p += im.stride) {
    const auto left = load4(p);
    row[r] = hn::MulAdd(fx, hn::Sub(load4(p + 1), left), left);
  }
  std::array<hn::Vec<D>, 16 / hn::MaxLanes(D())> out;
  if constexpr (hn::MaxLanes(D()) == 8) {
    for (int k = 0; k < 2; ++k) {
      const auto above = hn::Combine(df, row[2 * k + 1], row[2 * k]);
      const auto below = hn::Combine(df, row[2 * k + 2], row[2 * k + 1]);
      out[k] = hn::MulAdd(fy, hn::Sub(below, above), above);
    }
  } else {
    for (int k = 0; k < 4; ++k) out[k] = hn::MulAdd(fy, hn::Sub(row[k + 1], row[k]), row[k]);
  }
  return out;
}

}  // namespace godwit::vo
