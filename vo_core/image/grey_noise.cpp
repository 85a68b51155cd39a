#include "vo_core/image/grey_noise.h"

#include <algorithm>
#include <array>
#include <cstdlib>

namespace godwit::vo {
namespace {
constexpr int kBlock = 16;
constexpr int kMaxBlocks = 4096;
/// Mean grey level of a block nearer than this to either end of the scale: its noise is cut off.
constexpr int kClipped = 5;
/// The mask's response to white noise of sigma 1 has this mean: 6 sqrt(2 / pi).
constexpr float kResponse = 4.787f;
}  // namespace

float grey_noise(const rt::ImageView& image) {
  std::array<float, kMaxBlocks> response;
  int blocks = 0;
  // Every second block of every second row of blocks; with larger pictures fewer still.
  int step = 2;
  while (image.width / (kBlock * step) * (image.height / (kBlock * step)) > kMaxBlocks) ++step;
  for (int by = 1; by + kBlock + 1 <= image.height; by += kBlock * step) {
    for (int bx = 1; bx + kBlock + 1 <= image.width; bx += kBlock * step) {
      int sum = 0, grey = 0;
      for (int y = by; y < by + kBlock; ++y) {
        const std::uint8_t *above = image.row(y - 1), *row = image.row(y), *below = image.row(y + 1);
        for (int x = bx; x < bx + kBlock; ++x) {
          sum += std::abs(above[x - 1] - 2 * above[x] + above[x + 1] - 2 * row[x - 1] + 4 * row[x] - 2 * row[x + 1] +
                          below[x - 1] - 2 * below[x] + below[x + 1]);
          grey += row[x];
        }
      }
      if (grey < kClipped * kBlock * kBlock || grey > (255 - kClipped) * kBlock * kBlock) continue;
      response[blocks++] = static_cast<float>(sum) / (kBlock * kBlock);
      if (blocks == kMaxBlocks) break;
    }
    if (blocks == kMaxBlocks) break;
  }
  if (blocks == 0) return kLeastGreyNoise;
  const auto quiet = response.begin() + blocks / 10;
  std::nth_element(response.begin(), quiet, response.begin() + blocks);
  return std::max(kLeastGreyNoise, *quiet / kResponse);
}

}  // namespace godwit::vo
