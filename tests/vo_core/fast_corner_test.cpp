#include "vo_core/features/fast_corner.h"

#include <algorithm>
#include <gtest/gtest.h>
#include <random>
#include <vector>

#include "tests/vo_core/synthetic_picture.h"

namespace godwit::vo {
namespace fast_corner_test {

TEST(FastCorner, ScoreIsTheSmallestDifferenceOfTheBestArc) {
  test::Picture picture(7, 7, 100);
  EXPECT_EQ(fast_score(picture.view(), 3, 3), 0);
  // Nine neighbouring pixels from the top clockwise, the weakest 30 above the centre.
  const int arc[9][2] = {{3, 0}, {4, 0}, {5, 1}, {6, 2}, {6, 3}, {6, 4}, {5, 5}, {4, 6}, {3, 6}};
  for (const auto& p : arc) picture(p[0], p[1]) = 180;
  picture(6, 3) = 130;
  EXPECT_EQ(fast_score(picture.view(), 3, 3), 30);
  // Eight are not enough.
  picture(3, 6) = 100;
  EXPECT_EQ(fast_score(picture.view(), 3, 3), 0);
  // Darker counts as brighter does.
  for (const auto& p : arc) picture(p[0], p[1]) = 40;
  EXPECT_EQ(fast_score(picture.view(), 3, 3), 60);
}

/// Noise, plain steps that saturate, and rectangles: every branch of the fast code.
std::vector<test::Picture> pictures(int width, int height) {
  std::vector<test::Picture> list;
  list.emplace_back(width, height, std::uint8_t{128});
  list.back().add_noise(60.0, 3);
  list.emplace_back(width, height, std::uint8_t{0});
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) list.back()(x, y) = (x / 5 + y / 7) % 2 != 0 ? 255 : 0;
  }
  list.push_back(test::rectangles(width, height, width * height / 400 + 1, 4));
  return list;
}

TEST(FastCorner, RowOfScoresEqualsScalarAndTouchesNothingElse) {
  for (const auto& [width, height] : {std::pair(640, 48), std::pair(641, 31), std::pair(39, 20), std::pair(17, 12),
                                      std::pair(7, 7), std::pair(71, 9), std::pair(38, 9)}) {
    for (const test::Picture& picture : pictures(width, height)) {
      for (const int threshold : {0, 5, 20, 254}) {
        for (int y = 3; y < height - 3; ++y) {
          std::vector<std::uint8_t> scores(static_cast<std::size_t>(width), 0xA5);
          fast_score_row(picture.view(), y, 3, width - 3, threshold, scores.data());
          for (int x = 0; x < width; ++x) {
            int expected = 0xA5;
            if (x >= 3 && x < width - 3) {
              expected = fast_score(picture.view(), x, y);
              if (expected <= threshold) expected = 0;
            }
            ASSERT_EQ(scores[static_cast<std::size_t>(x)], expected) << width << " at " << x << " " << y;
          }
        }
      }
    }
  }
}

TEST(FastCorner, MaximaEqualScalarAndPlateausGiveOne) {
  std::mt19937 random(8);
  for (const int width : {9, 33, 34, 66, 200}) {
    for (int round = 0; round < 50; ++round) {
      const auto size = static_cast<std::size_t>(width);
      std::vector<std::vector<std::uint8_t>> row(3, std::vector<std::uint8_t>(size, 0));
      // Few values, so that equal neighbours are common.
      for (auto& r : row) {
        for (std::size_t x = 1; x + 1 < size; ++x)
          r[x] = static_cast<std::uint8_t>(random() % 4 == 0 ? random() % 5 * 60 : 0);
      }
      std::vector<std::int16_t> expected;
      for (std::size_t x = 1; x + 1 < size; ++x) {
        const int c = row[1][x];
        bool best = c > row[1][x - 1] && c >= row[1][x + 1];
        for (std::size_t i = x - 1; i <= x + 1; ++i) best = best && c > row[0][i] && c >= row[2][i];
        if (best) expected.push_back(static_cast<std::int16_t>(x));
      }
      std::vector<std::int16_t> xs(size / 2 + 1, -1);
      const int count = fast_maxima_row(row[0].data(), row[1].data(), row[2].data(), 1, width - 1, xs.data());
      xs.resize(static_cast<std::size_t>(count));
      ASSERT_EQ(xs, expected) << "width " << width;
    }
  }
  // A flat top two wide and two high is one maximum, its first pixel.
  const std::vector<std::uint8_t> zero(6, 0), top{0, 0, 50, 50, 0, 0};
  std::int16_t xs[4];
  ASSERT_EQ(fast_maxima_row(zero.data(), top.data(), top.data(), 1, 5, xs), 1);
  EXPECT_EQ(xs[0], 2);
  EXPECT_EQ(fast_maxima_row(top.data(), top.data(), zero.data(), 1, 5, xs), 0);
}

}  // namespace fast_corner_test
}  // namespace godwit::vo
