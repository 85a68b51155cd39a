// FAST-9 against OpenCV's, which was written independently.
#include <gtest/gtest.h>
#include <opencv2/features2d.hpp>
#include <set>
#include <vector>

#include "tests/vo_core/synthetic_picture.h"
#include "vo_core/features/fast_corner.h"

namespace godwit::vo {
namespace fast_corner_opencv_test {

using Points = std::set<std::pair<int, int>>;

Points opencv_fast(test::Picture& picture, int threshold, bool suppress) {
  const cv::Mat image(picture.height(), picture.width(), CV_8U, &picture(0, 0));
  std::vector<cv::KeyPoint> found;
  cv::FAST(image, found, threshold, suppress, cv::FastFeatureDetector::TYPE_9_16);
  Points points;
  for (const cv::KeyPoint& k : found) points.emplace(static_cast<int>(k.pt.x), static_cast<int>(k.pt.y));
  return points;
}

class EachThreshold : public testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(FastCornerOpenCv, EachThreshold, testing::Values(5, 10, 20, 40, 80));

TEST_P(EachThreshold, SameCornersAsOpenCv) {
  const int threshold = GetParam();
  for (const int width : {640, 333}) {
    test::Picture picture = test::rectangles(width, 240, 200, 21);
    const std::size_t row = static_cast<std::size_t>(width);
    std::vector<std::uint8_t> scores(row * 240, 0);
    for (int y = 3; y < 237; ++y) {
      fast_score_row(picture.view(), y, 3, width - 3, threshold, scores.data() + static_cast<std::size_t>(y) * row);
    }
    Points corners, maxima;
    std::vector<std::int16_t> xs(row);
    for (int y = 3; y < 237; ++y) {
      const std::uint8_t* r = scores.data() + static_cast<std::size_t>(y) * row;
      for (int x = 3; x < width - 3; ++x) {
        if (r[x] != 0) corners.emplace(x, y);
      }
      const int count = fast_maxima_row(r - row, r, r + row, 3, width - 3, xs.data());
      for (int i = 0; i < count; ++i) maxima.emplace(xs[static_cast<std::size_t>(i)], y);
    }
    const Points expected = opencv_fast(picture, threshold, false);
    ASSERT_GT(expected.size(), 20u);
    EXPECT_EQ(corners, expected);
    // OpenCV drops both of two equal neighbours, we keep the first: all of its maxima are ours, and what we have more
    // touches an equal.
    const Points strict = opencv_fast(picture, threshold, true);
    for (const auto& p : strict) EXPECT_TRUE(maxima.count(p)) << p.first << " " << p.second;
    for (const auto& [x, y] : maxima) {
      if (strict.count({x, y})) continue;
      bool equal = false;
      for (int dy = -1; dy <= 1; ++dy) {
        for (int dx = -1; dx <= 1; ++dx) {
          const auto at = [&](int px, int py) {
            return scores[static_cast<std::size_t>(py) * row + static_cast<std::size_t>(px)];
          };
          equal = equal || ((dx != 0 || dy != 0) && at(x + dx, y + dy) == at(x, y));
        }
      }
      EXPECT_TRUE(equal) << x << " " << y;
    }
  }
}

}  // namespace fast_corner_opencv_test
}  // namespace godwit::vo
