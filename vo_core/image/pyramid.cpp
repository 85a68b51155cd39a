#include "vo_core/image/pyramid.h"

#include <cassert>
#include <hwy/cache_control.h>
#include <hwy/highway.h>

namespace godwit::vo {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

// A build that misses the vector unit it was configured for would still pass every test, several times slower.
#if defined(__AVX2__)
static_assert(HWY_STATIC_TARGET <= HWY_AVX2, "Highway does not use AVX2: is HWY_DISABLE_PCLMUL_AES missing?");
#else
static_assert(HWY_STATIC_TARGET != HWY_SCALAR && HWY_STATIC_TARGET != HWY_EMU128, "Highway fell back to scalar code");
#endif

std::ptrdiff_t aligned_stride(int width) {
  return (static_cast<std::ptrdiff_t>(width) + rt::kRowAlignment - 1) / rt::kRowAlignment * rt::kRowAlignment;
}

void half_sample_scalar(const std::uint8_t* top, const std::uint8_t* bottom, std::uint8_t* out, int count) {
  for (int x = 0; x < count; ++x) {
    out[x] = static_cast<std::uint8_t>((top[2 * x] + top[2 * x + 1] + bottom[2 * x] + bottom[2 * x + 1] + 2) >> 2);
  }
}

}  // namespace

void half_sample(const rt::ImageView& src, const rt::MutableImageView& dst) {
  assert(dst.width == src.width / 2 && dst.height == src.height / 2);
  const hn::ScalableTag<std::uint8_t> d8;
  const hn::Repartition<std::uint16_t, decltype(d8)> d16;
  const int lanes = static_cast<int>(hn::Lanes(d8));
  const auto low_byte = hn::Set(d16, std::uint16_t{0x00FF});
  const auto two = hn::Set(d16, std::uint16_t{2});

  // Rounded means of the 2x2 blocks under one vector of each row, as 16-bit lanes.
  const auto block_mean = [&](const std::uint8_t* top, const std::uint8_t* bottom) {
    const auto t = hn::BitCast(d16, hn::LoadU(d8, top));
    const auto b = hn::BitCast(d16, hn::LoadU(d8, bottom));
    const auto even = hn::Add(hn::And(t, low_byte), hn::And(b, low_byte));
    const auto odd = hn::Add(hn::ShiftRight<8>(t), hn::ShiftRight<8>(b));
    return hn::ShiftRight<2>(hn::Add(hn::Add(even, odd), two));
  };

  // The picture has just come and lies in no cache near by; which rows are next the processor does not guess in time.
  const std::ptrdiff_t ahead = std::ptrdiff_t{4} * src.stride;
  for (int y = 0; y < dst.height; ++y) {
    const std::uint8_t* top = src.row(2 * y);
    const std::uint8_t* bottom = src.row(2 * y + 1);
    std::uint8_t* out = dst.row(y);
    if (dst.width < lanes) {
      half_sample_scalar(top, bottom, out, dst.width);
      continue;
    }
    for (int x = 0;;) {
      hwy::Prefetch(top + 2 * x + ahead);
      hwy::Prefetch(bottom + 2 * x + ahead);
      const auto low = block_mean(top + 2 * x, bottom + 2 * x);
      const auto high = block_mean(top + 2 * x + lanes, bottom + 2 * x + lanes);
      hn::StoreU(hn::ConcatEven(d8, hn::BitCast(d8, high), hn::BitCast(d8, low)), d8, out + x);
      if (x + lanes == dst.width) break;
      // The last vector overlaps the one before it rather than reaching over the end of the row.
      x = x + 2 * lanes <= dst.width ? x + lanes : dst.width - lanes;
    }
  }
}

std::size_t pyramid_bytes(int width, int height, int levels) {
  std::size_t bytes = 0;
  for (int l = 1; l < levels; ++l) {
    bytes += aligned_stride(width >> l) * (height >> l);
  }
  // image.h promises readable bytes behind the last pixel.
  return bytes + rt::kRowAlignment;
}

rt::PyramidView build_pyramid(const rt::ImageView& base, int levels, std::uint8_t* storage,
                              [[maybe_unused]] std::size_t storage_bytes) {
  assert(levels >= 1 && levels <= rt::kPyramidLevels);
  assert((base.width >> (levels - 1)) > 0 && (base.height >> (levels - 1)) > 0);
  assert(storage_bytes >= pyramid_bytes(base.width, base.height, levels));
  assert(reinterpret_cast<std::uintptr_t>(storage) % rt::kRowAlignment == 0);
  rt::PyramidView pyramid;
  pyramid.levels = levels;
  pyramid.level[0] = base;
  for (int l = 1; l < levels; ++l) {
    const rt::MutableImageView level{storage, base.width >> l, base.height >> l,
                                     static_cast<int>(aligned_stride(base.width >> l))};
    half_sample(pyramid.level[l - 1], level);
    pyramid.level[l] = level;
    storage += static_cast<std::ptrdiff_t>(level.stride) * level.height;
  }
  return pyramid;
}

}  // namespace godwit::vo
