#include "hal/camera/pixels/rgb_rows.h"

#include <cstddef>
#include <cstring>
#include <hwy/highway.h>
#include <utility>

namespace godwit::hal {
namespace {

namespace wide = hwy::HWY_NAMESPACE;

constexpr int kRedShare = 77, kGreenShare = 150, kBlueShare = 29;

}  // namespace

void rgb_row(const std::uint8_t* from, int width, bool red_first, std::uint8_t* grey, std::uint8_t* bgr) {
  const wide::ScalableTag<std::uint16_t> sums;
  const wide::Rebind<std::uint8_t, decltype(sums)> bytes;
  const std::size_t w = width;
  const std::size_t step = wide::Lanes(bytes);
  std::size_t x = 0;
  for (; x + step <= w; x += step) {
    wide::Vec<decltype(bytes)> blue, green, red;
    wide::LoadInterleaved3(bytes, from + 3 * x, blue, green, red);
    if (red_first) std::swap(blue, red);
    // At most 255 * 256 + 128: fits.
    const auto share = [&](auto colour, int factor) {
      return wide::Mul(wide::PromoteTo(sums, colour), wide::Set(sums, static_cast<std::uint16_t>(factor)));
    };
    const auto sum = wide::Add(wide::Add(share(red, kRedShare), share(green, kGreenShare)),
                               wide::Add(share(blue, kBlueShare), wide::Set(sums, 128)));
    // At most 255, and so the same as a signed number.
    const wide::RebindToSigned<decltype(sums)> shorts;
    wide::StoreU(wide::DemoteTo(bytes, wide::BitCast(shorts, wide::ShiftRight<8>(sum))), bytes, grey + x);
    if (bgr != nullptr && red_first) wide::StoreInterleaved3(blue, green, red, bytes, bgr + 3 * x);
  }
  for (; x < w; ++x) {
    const std::uint8_t* const p = from + 3 * x;
    const int blue = p[red_first ? 2 : 0], green = p[1], red = p[red_first ? 0 : 2];
    grey[x] = static_cast<std::uint8_t>((kRedShare * red + kGreenShare * green + kBlueShare * blue + 128) >> 8);
    if (bgr == nullptr || !red_first) continue;
    bgr[3 * x] = p[2];
    bgr[3 * x + 1] = p[1];
    bgr[3 * x + 2] = p[0];
  }
  if (bgr != nullptr && !red_first) std::memcpy(bgr, from, 3 * w);
}

}  // namespace godwit::hal
