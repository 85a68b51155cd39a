#include "vo_core/image/thumbnail.h"

#include <algorithm>
#include <cmath>

namespace godwit::vo {
namespace {
constexpr int kMinOverlap = Thumbnail::kCells / 5;

/// Binomial 1 2 1 along both axes over the valid cells, in place: a shift of half a cell must not spoil the likeness.
void blur(Thumbnail* t) {
  constexpr int kW = Thumbnail::kWidth, kH = Thumbnail::kHeight;
  const auto along = [&](int count, int lines, int step, int line_step) {
    for (int line = 0; line < lines; ++line) {
      std::int16_t* v = t->value.data() + line * line_step;
      const std::int16_t* valid = t->valid.data() + line * line_step;
      int before = 0, before_valid = 0;
      for (int i = 0; i < count; ++i) {
        const int here = v[i * step], here_valid = valid[i * step];
        const int after = i + 1 < count ? v[(i + 1) * step] : 0,
                  after_valid = i + 1 < count ? valid[(i + 1) * step] : 0;
        const int weight = before_valid + 2 * here_valid + after_valid;
        if (here_valid) v[i * step] = static_cast<std::int16_t>((before + 2 * here + after) / weight);
        before = here;
        before_valid = here_valid;
      }
    }
  };
  along(kW, kH, 1, kW);
  along(kH, kW, kW, 1);
}
}  // namespace

Thumbnail make_thumbnail(const rt::PyramidView& pyramid, const rt::MaskPyramidView& mask, double roll_rad) {
  Thumbnail out;
  const std::size_t top = pyramid.levels - 1;
  const rt::ImageView& image = pyramid.level[top];
  const bool masked = mask.levels == pyramid.levels;
  // A grid of four samples a cell, turned about the centre.
  constexpr int kSamples = 2;
  const double cx = 0.5 * (image.width - 1), cy = 0.5 * (image.height - 1);
  const double step_x = static_cast<double>(image.width) / (kSamples * Thumbnail::kWidth);
  const double step_y = static_cast<double>(image.height) / (kSamples * Thumbnail::kHeight);
  const double c = std::cos(roll_rad), s = std::sin(roll_rad);
  int sum = 0, count = 0;
  for (int y = 0; y < Thumbnail::kHeight; ++y) {
    for (int x = 0; x < Thumbnail::kWidth; ++x) {
      int grey = 0, seen = 0;
      for (int k = 0; k < kSamples * kSamples; ++k) {
        const double u = (x * kSamples + k % kSamples + 0.5) * step_x - 0.5 - cx;
        const double v = (y * kSamples + k / kSamples + 0.5) * step_y - 0.5 - cy;
        const int px = static_cast<int>(std::lround(cx + c * u - s * v));
        const int py = static_cast<int>(std::lround(cy + s * u + c * v));
        if (px < 0 || py < 0 || px >= image.width || py >= image.height) continue;
        if (masked && mask.level[top].at(px, py) != 0) continue;
        grey += image.at(px, py);
        ++seen;
      }
      const std::size_t i = y * Thumbnail::kWidth + x;
      out.valid[i] = seen == kSamples * kSamples;
      out.value[i] = static_cast<std::int16_t>(out.valid[i] ? grey / seen : 0);
      sum += out.value[i];
      count += out.valid[i];
    }
  }
  blur(&out);
  blur(&out);
  const int mean = count > 0 ? sum / count : 0;
  for (std::size_t i = 0; i < out.value.size(); ++i)
    out.value[i] = static_cast<std::int16_t>(out.valid[i] ? out.value[i] - mean : 0);
  return out;
}

bool shows_nothing(const rt::PyramidView& pyramid) {
  const rt::ImageView& image = pyramid.level[std::min(2, pyramid.levels - 1)];
  std::int64_t sum = 0, squares = 0;
  for (int y = 0; y < image.height; ++y) {
    const std::uint8_t* row = image.row(y);
    for (int x = 0; x < image.width; ++x) {
      sum += row[x];
      squares += row[x] * row[x];
    }
  }
  const auto n = static_cast<std::int64_t>(image.width) * image.height;
  return n * squares - sum * sum < n * n;
}

ThumbnailMatch match_thumbnails(const Thumbnail& ref, const Thumbnail& cur) {
  ThumbnailMatch best;
  for (int dy = -kMaxShiftY; dy <= kMaxShiftY; dy += 2) {
    for (int dx = -kMaxShiftX; dx <= kMaxShiftX; dx += 2) {
      const int x0 = std::max(0, -dx), x1 = std::min(Thumbnail::kWidth, Thumbnail::kWidth - dx);
      const int y0 = std::max(0, -dy), y1 = std::min(Thumbnail::kHeight, Thumbnail::kHeight - dy);
      std::int32_t n = 0, a1 = 0, b1 = 0, aa = 0, bb = 0, ab = 0;
      for (int y = y0; y < y1; ++y) {
        const std::int16_t* a = ref.value.data() + y * Thumbnail::kWidth;
        const std::int16_t* va = ref.valid.data() + y * Thumbnail::kWidth;
        const std::int16_t* b = cur.value.data() + (y + dy) * Thumbnail::kWidth + dx;
        const std::int16_t* vb = cur.valid.data() + (y + dy) * Thumbnail::kWidth + dx;
        for (int x = x0; x < x1; ++x) {
          const std::int32_t p = a[x] * vb[x], q = b[x] * va[x];
          n += va[x] * vb[x];
          a1 += p;
          b1 += q;
          aa += p * p;
          bb += q * q;
          ab += p * q;
        }
      }
      if (n < kMinOverlap) continue;
      const float fn = static_cast<float>(n);
      const float saa = static_cast<float>(aa) - static_cast<float>(a1) * static_cast<float>(a1) / fn;
      const float sbb = static_cast<float>(bb) - static_cast<float>(b1) * static_cast<float>(b1) / fn;
      const float sab = static_cast<float>(ab) - static_cast<float>(a1) * static_cast<float>(b1) / fn;
      // Flat pictures (below one grey level rms) resemble nothing.
      if (saa < fn || sbb < fn) continue;
      const float correlation = sab / std::sqrt(saa * sbb);
      if (correlation > best.correlation) best = {correlation, dx, dy};
    }
  }
  return best;
}

}  // namespace godwit::vo
