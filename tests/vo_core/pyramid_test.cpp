#include "vo_core/image/pyramid.h"

#include <gtest/gtest.h>
#include <random>
#include <tuple>
#include <vector>

namespace godwit::vo {
namespace pyramid_test {

/// Filled with noise, full range: any carry or rounding mistake shows.
std::vector<std::uint8_t> noise(std::size_t size) {
  std::mt19937 random(11);
  std::vector<std::uint8_t> bytes(size);
  for (std::uint8_t& b : bytes) b = static_cast<std::uint8_t>(random() >> 13);
  return bytes;
}

int block_mean(const rt::ImageView& image, int x, int y) {
  return (image.at(2 * x, 2 * y) + image.at(2 * x + 1, 2 * y) + image.at(2 * x, 2 * y + 1) +
          image.at(2 * x + 1, 2 * y + 1) + 2) /
         4;
}

class HalfSample : public testing::TestWithParam<std::tuple<int, int, int>> {};
INSTANTIATE_TEST_SUITE_P(Sizes, HalfSample,
                         testing::Values(std::tuple(640, 480, 640), std::tuple(752, 480, 768),
                                         std::tuple(641, 479, 641), std::tuple(641, 479, 704), std::tuple(2, 2, 2),
                                         std::tuple(3, 5, 3), std::tuple(31, 8, 37), std::tuple(63, 9, 63),
                                         std::tuple(64, 4, 64), std::tuple(65, 7, 65), std::tuple(127, 6, 128),
                                         std::tuple(130, 6, 130), std::tuple(1280, 1024, 1280)));

TEST_P(HalfSample, EqualsScalarToTheBitAndWritesNothingElse) {
  const auto [width, height, stride] = GetParam();
  // The buffers end with the last pixel, so that the address sanitizer sees any read or write behind it.
  const std::vector<std::uint8_t> source = noise(static_cast<std::size_t>(stride * (height - 1) + width));
  const rt::ImageView src{source.data(), width, height, stride};
  const int w = width / 2, h = height / 2, dst_stride = w + 5;
  std::vector<std::uint8_t> target(static_cast<std::size_t>(dst_stride * (h - 1) + w), 0xA5);
  half_sample(src, {target.data(), w, h, dst_stride});
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < dst_stride; ++x) {
      const std::size_t i = static_cast<std::size_t>(y * dst_stride + x);
      if (i >= target.size()) break;
      ASSERT_EQ(target[i], x < w ? block_mean(src, x, y) : 0xA5) << x << " " << y;
    }
  }
}

TEST(Pyramid, LevelsHaveTheirSizesAlignedRowsAndContents) {
  for (const auto& [width, height] : {std::pair(640, 480), std::pair(752, 480), std::pair(641, 479)}) {
    const std::vector<std::uint8_t> base = noise(static_cast<std::size_t>(width * height));
    const std::size_t bytes = pyramid_bytes(width, height, rt::kPyramidLevels);
    std::vector<std::uint8_t> buffer(bytes + rt::kRowAlignment, 0xA5);
    auto* storage = buffer.data();
    while (reinterpret_cast<std::uintptr_t>(storage) % rt::kRowAlignment != 0) ++storage;
    const rt::PyramidView pyramid =
        build_pyramid({base.data(), width, height, width}, rt::kPyramidLevels, storage, bytes);
    ASSERT_EQ(pyramid.levels, rt::kPyramidLevels);
    EXPECT_EQ(pyramid.level[0].data, base.data());
    for (int l = 1; l < rt::kPyramidLevels; ++l) {
      const rt::ImageView& finer = pyramid.level[static_cast<std::size_t>(l - 1)];
      const rt::ImageView& level = pyramid.level[static_cast<std::size_t>(l)];
      ASSERT_EQ(level.width, width >> l);
      ASSERT_EQ(level.height, height >> l);
      ASSERT_EQ(level.stride % rt::kRowAlignment, 0);
      ASSERT_EQ(reinterpret_cast<std::uintptr_t>(level.data) % rt::kRowAlignment, 0u);
      // What image.h promises: readable bytes behind the last pixel.
      ASSERT_LE(level.row(level.height - 1) + level.width + rt::kRowAlignment, storage + bytes);
      for (int y = 0; y < level.height; ++y) {
        for (int x = 0; x < level.width; ++x) ASSERT_EQ(level.at(x, y), block_mean(finer, x, y));
      }
    }
  }
}

TEST(Pyramid, OneLevelIsThePictureItself) {
  const std::vector<std::uint8_t> base = noise(64 * 48);
  alignas(rt::kRowAlignment) std::array<std::uint8_t, rt::kRowAlignment> storage;
  const rt::PyramidView pyramid = build_pyramid({base.data(), 64, 48, 64}, 1, storage.data(), storage.size());
  EXPECT_EQ(pyramid.levels, 1);
  EXPECT_EQ(pyramid.level[0].data, base.data());
}

}  // namespace pyramid_test
}  // namespace godwit::vo
