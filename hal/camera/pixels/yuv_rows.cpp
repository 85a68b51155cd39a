#include "hal/camera/pixels/yuv_rows.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <hwy/highway.h>

namespace godwit::hal {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

using Shorts = hn::ScalableTag<std::int16_t>;
using HalfBytes = hn::Rebind<std::uint8_t, Shorts>;
using Bytes = hn::ScalableTag<std::uint8_t>;
using Pixels = hn::Vec<HalfBytes>;

/// Pixels whose colours are reckoned before they are put beside one another: fits a level-1 cache.
constexpr std::size_t kRun = 256;

/// One colour of a run of pixels each.
struct Planes {
  alignas(64) std::array<std::uint8_t, kRun> blue, green, red;
};

std::uint8_t saturated(int value) {
  return static_cast<std::uint8_t>(std::clamp(value, 0, 255));
}

/// What chroma adds to a luma: whole steps, and 256ths.
template <typename V>
struct Chroma {
  V blue, green, red, blue_rest, green_rest, red_rest;
};
/// A luma that chroma is added to, likewise.
template <typename V>
struct Luma {
  V whole, rest;
};

using Wide = hn::Vec<Shorts>;

Wide times(Wide x, std::int16_t factor) {
  return hn::Mul(x, hn::Set(Shorts(), factor));
}
Wide from_middle(Pixels chroma) {
  return hn::Sub(hn::PromoteTo(Shorts(), chroma), hn::Set(Shorts(), 128));
}

/// As bgr_of_yuv to the bit: whole 256ths are taken out of the factors (298 = 256 + 42, 516 = 512 + 4, 208 = 256 - 48,
/// 409 = 256 + 153), and what is left fits 16 bits.
struct LimitedRange {
  static Chroma<Wide> chroma(Wide d, Wide e) {
    return {hn::Add(d, d), hn::Neg(e), e, times(d, 4), hn::Sub(times(e, 48), times(d, 100)), times(e, 153)};
  }
  static Luma<Wide> luma(Wide y) {
    const Wide above = hn::Max(hn::Sub(y, hn::Set(Shorts(), 16)), hn::Zero(Shorts()));
    return {above, hn::Add(times(above, 42), hn::Set(Shorts(), 128))};
  }
};
/// As bgr_of_jpeg: 454 = 512 - 58, 183 = 256 - 73, 359 = 256 + 103.
struct FullRange {
  static Chroma<Wide> chroma(Wide d, Wide e) {
    return {hn::Add(d, d), hn::Neg(e), e, times(d, -58), hn::Sub(times(e, 73), times(d, 88)), times(e, 103)};
  }
  static Luma<Wide> luma(Wide y) { return {y, hn::Set(Shorts(), 128)}; }
};

/// Of pixels at even and at odd places, which share their chroma.
template <typename Range>
void colours(Pixels even, Pixels odd, Pixels u, Pixels v, std::size_t at, Planes* to) {
  const HalfBytes narrow;
  const Chroma<Wide> c = Range::chroma(from_middle(u), from_middle(v));
  struct Colours {
    Pixels blue, green, red;
  };
  const auto of = [&](Pixels luma) {
    const Luma<Wide> y = Range::luma(hn::PromoteTo(Shorts(), luma));
    // Demoting saturates.
    const auto sum = [&](Wide whole, Wide more) {
      return hn::DemoteTo(narrow, hn::Add(hn::Add(y.whole, whole), hn::ShiftRight<8>(hn::Add(y.rest, more))));
    };
    return Colours{sum(c.blue, c.blue_rest), sum(c.green, c.green_rest), sum(c.red, c.red_rest)};
  };
  const Colours a = of(even), b = of(odd);
  hn::StoreInterleaved2(a.blue, b.blue, narrow, to->blue.data() + at);
  hn::StoreInterleaved2(a.green, b.green, narrow, to->green.data() + at);
  hn::StoreInterleaved2(a.red, b.red, narrow, to->red.data() + at);
}

void put_together(const Planes& p, std::size_t count, std::uint8_t* bgr) {
  const Bytes bytes;
  std::size_t i = 0;
  for (; i + hn::Lanes(bytes) <= count; i += hn::Lanes(bytes)) {
    hn::StoreInterleaved3(hn::Load(bytes, p.blue.data() + i), hn::Load(bytes, p.green.data() + i),
                          hn::Load(bytes, p.red.data() + i), bytes, bgr + 3 * i);
  }
  for (; i < count; ++i) {
    bgr[3 * i] = p.blue[i];
    bgr[3 * i + 1] = p.green[i];
    bgr[3 * i + 2] = p.red[i];
  }
}

/// read(x, ..): luma at even and odd places, U and V from pixel x on; scalar(x): one pair of pixels.
template <typename Range, typename Read, typename Pair>
void row(std::size_t width, std::uint8_t* bgr, Read read, Pair pair) {
  const std::size_t step = 2 * hn::Lanes(HalfBytes());
  Planes planes;
  std::size_t x = 0;
  while (x + step <= width) {
    const std::size_t begin = x;
    for (; x + step <= width && x + step - begin <= kRun; x += step) {
      Pixels even, odd, u, v;
      read(x, even, odd, u, v);
      colours<Range>(even, odd, u, v, x - begin, &planes);
    }
    put_together(planes, x - begin, bgr + 3 * begin);
  }
  for (; x + 1 < width; x += 2) pair(x);
}

}  // namespace

void bgr_of_yuv(int y, int u, int v, std::uint8_t* to) {
  const int c = 298 * std::max(0, y - 16) + 128, d = u - 128, e = v - 128;
  to[0] = saturated((c + 516 * d) >> 8);
  to[1] = saturated((c - 100 * d - 208 * e) >> 8);
  to[2] = saturated((c + 409 * e) >> 8);
}

void bgr_of_jpeg(int y, int cb, int cr, std::uint8_t* to) {
  const int d = cb - 128, e = cr - 128;
  to[0] = saturated(y + ((454 * d + 128) >> 8));
  to[1] = saturated(y + ((128 - 88 * d - 183 * e) >> 8));
  to[2] = saturated(y + ((359 * e + 128) >> 8));
}

void yuyv_row(const std::uint8_t* from, int width, std::uint8_t* grey, std::uint8_t* bgr) {
  const std::size_t w = width;
  const Bytes bytes;
  const std::size_t step = hn::Lanes(bytes);
  std::size_t x = 0;
  for (; x + step <= w; x += step) {
    hn::Vec<Bytes> luma, chroma;
    hn::LoadInterleaved2(bytes, from + 2 * x, luma, chroma);
    hn::StoreU(luma, bytes, grey + x);
  }
  for (; x < w; ++x) grey[x] = from[2 * x];
  if (bgr == nullptr) return;
  row<LimitedRange>(
      w, bgr,
      [&](std::size_t at, Pixels& even, Pixels& odd, Pixels& u, Pixels& v) {
        hn::LoadInterleaved4(HalfBytes(), from + 2 * at, even, u, odd, v);
      },
      [&](std::size_t at) {
        const std::uint8_t* const p = from + 2 * at;
        bgr_of_yuv(p[0], p[1], p[3], bgr + 3 * at);
        bgr_of_yuv(p[2], p[1], p[3], bgr + 3 * at + 3);
      });
}

void nv12_row(const std::uint8_t* luma, const std::uint8_t* chroma, int width, std::uint8_t* bgr) {
  row<LimitedRange>(
      width, bgr,
      [&](std::size_t at, Pixels& even, Pixels& odd, Pixels& u, Pixels& v) {
        hn::LoadInterleaved2(HalfBytes(), luma + at, even, odd);
        hn::LoadInterleaved2(HalfBytes(), chroma + at, u, v);
      },
      [&](std::size_t at) {
        bgr_of_yuv(luma[at], chroma[at], chroma[at + 1], bgr + 3 * at);
        bgr_of_yuv(luma[at + 1], chroma[at], chroma[at + 1], bgr + 3 * at + 3);
      });
}

void jpeg_row(const std::uint8_t* luma, const std::uint8_t* cb, const std::uint8_t* cr, int width, std::uint8_t* bgr) {
  const std::size_t w = width;
  row<FullRange>(
      w, bgr,
      [&](std::size_t at, Pixels& even, Pixels& odd, Pixels& u, Pixels& v) {
        hn::LoadInterleaved2(HalfBytes(), luma + at, even, odd);
        u = hn::LoadU(HalfBytes(), cb + at / 2);
        v = hn::LoadU(HalfBytes(), cr + at / 2);
      },
      [&](std::size_t at) {
        bgr_of_jpeg(luma[at], cb[at / 2], cr[at / 2], bgr + 3 * at);
        bgr_of_jpeg(luma[at + 1], cb[at / 2], cr[at / 2], bgr + 3 * at + 3);
      });
  if (w % 2 != 0) bgr_of_jpeg(luma[w - 1], cb[w / 2], cr[w / 2], bgr + 3 * (w - 1));
}

}  // namespace godwit::hal
