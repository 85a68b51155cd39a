#include "vo_core/image/patch.h"

#include <array>
#include <cmath>
#include <gtest/gtest.h>
#include <vector>

#include "tests/vo_core/synthetic_picture.h"

namespace godwit::vo {
namespace patch_test {

/// Noise over the full range: neighbouring pixels differ as much as they can.
test::Picture noise(int width, int height) {
  test::Picture picture(width, height, 128);
  picture.add_noise(90.0, 5);
  return picture;
}

/// The definition, pixel by pixel in double precision.
double bilinear(const rt::ImageView& im, double x, double y) {
  const int xi = static_cast<int>(std::floor(x)), yi = static_cast<int>(std::floor(y));
  const double fx = x - xi, fy = y - yi;
  return (1 - fy) * ((1 - fx) * im.at(xi, yi) + fx * im.at(xi + 1, yi)) +
         fy * ((1 - fx) * im.at(xi, yi + 1) + fx * im.at(xi + 1, yi + 1));
}

/// What the vector paths may be off [grey levels]: 1e-5 of their range.
constexpr double kAllowed = 1e-5 * 255;

TEST(Patch, LoadedPixelsAreThePicturesBytes) {
  std::array<std::uint8_t, 256 + 8> bytes{};
  for (std::size_t i = 0; i < bytes.size(); ++i) bytes[i] = static_cast<std::uint8_t>(i * 37);
  const hn::FixedTag<float, 4> d4;
  const RowTag row;
  std::array<float, 8> out{};
  for (std::size_t i = 0; i < 256; ++i) {
    hn::StoreU(load4(&bytes[i]), d4, out.data());
    for (std::size_t k = 0; k < 4; ++k) ASSERT_EQ(out[k], static_cast<float>(bytes[i + k]));
    hn::StoreU(load_row(&bytes[i]), row, out.data());
    for (std::size_t k = 0; k < hn::Lanes(row); ++k) ASSERT_EQ(out[k], static_cast<float>(bytes[i + k]));
  }
}

TEST(Patch, SampledGridEqualsScalar) {
  const test::Picture picture = noise(64, 48);
  const rt::ImageView im = picture.view();
  for (const int quads : {1, 2, 3}) {
    for (const int rows : {1, 4, 9}) {
      std::vector<float> out(static_cast<std::size_t>(4 * quads * rows));
      for (double y = 1; y < 30; y += 0.37) {
        for (double x = 1; x < 45; x += 1.171) {
          const float xf = static_cast<float>(x), yf = static_cast<float>(y);
          sample_grid(im, xf, yf, quads, rows, out.data());
          for (int r = 0; r < rows; ++r) {
            for (int c = 0; c < 4 * quads; ++c) {
              const double expected = bilinear(im, static_cast<double>(xf) + c, static_cast<double>(yf) + r);
              ASSERT_NEAR(static_cast<double>(out[static_cast<std::size_t>(r * 4 * quads + c)]), expected, kAllowed)
                  << x << " " << y << ", " << c << " " << r;
            }
          }
        }
      }
    }
  }
}

TEST(Patch, LanesAreSampledEachAtItsOwnPlace) {
  const test::Picture picture = noise(64, 48);
  const rt::ImageView im = picture.view();
  const RowTag row;
  constexpr std::size_t kLanes = hn::MaxLanes(RowTag());
  std::array<float, kLanes> x, y, out;
  for (int i = 0; i < 500; ++i) {
    for (std::size_t k = 0; k < kLanes; ++k) {
      // All over the picture, the first and the last places that have neighbours among them.
      const int n = i * static_cast<int>(kLanes) + static_cast<int>(k);
      x[k] = n % 7 == 0 ? 62.999f : static_cast<float>(std::fmod(n * 1.171, 63.0));
      y[k] = n % 11 == 0 ? 46.999f : static_cast<float>(std::fmod(n * 0.737, 47.0));
    }
    hn::StoreU(interpolate_lanes(im, hn::LoadU(row, x.data()), hn::LoadU(row, y.data())), row, out.data());
    for (std::size_t k = 0; k < kLanes; ++k)
      ASSERT_NEAR(static_cast<double>(out[k]), bilinear(im, static_cast<double>(x[k]), static_cast<double>(y[k])),
                  kAllowed)
          << x[k] << " " << y[k];
  }
}

TEST(Patch, AGridOfOneSampleEqualsTheDefinition) {
  const test::Picture picture = noise(40, 30);
  std::array<float, 4> grid{};
  for (float y = 0.01F; y < 28.0F; y += 0.61F) {
    for (float x = 0.01F; x < 34.0F; x += 0.83F) {
      const double expected = bilinear(picture.view(), static_cast<double>(x), static_cast<double>(y));
      sample_grid(picture.view(), x, y, 1, 1, grid.data());
      ASSERT_NEAR(static_cast<double>(grid[0]), expected, kAllowed);
    }
  }
}

}  // namespace patch_test
}  // namespace godwit::vo
