#include "vo_core/feature_detector.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <gtest/gtest.h>
#include <set>
#include <vector>

#include "tests/vo_core/synthetic_picture.h"
#include "vo_core/fast_corner.h"

namespace godwit::vo {
namespace {

std::vector<Feature> detect(FeatureDetector& detector, const rt::PyramidView& pyramid, const rt::MaskPyramidView& mask,
                            const std::vector<Vec2f>& occupied, int wanted) {
  std::vector<Feature> features(static_cast<std::size_t>(wanted));
  features.resize(static_cast<std::size_t>(detector.detect(pyramid, mask, occupied, wanted, features)));
  return features;
}

/// Pixel of the feature on a level.
Eigen::Vector2i on_level(const Feature& f, int level) {
  const float s = static_cast<float>(1 << level);
  return {static_cast<int>(std::lround((f.px.x() + 0.5f) / s - 0.5f)),
          static_cast<int>(std::lround((f.px.y() + 0.5f) / s - 0.5f))};
}

/// Cells of an 8x6 grid that hold a point.
int occupied_cells(const std::vector<Vec2f>& points, int width, int height) {
  std::set<int> cells;
  for (const Vec2f& p : points) {
    cells.insert(static_cast<int>(p.x()) * 8 / width + 8 * (static_cast<int>(p.y()) * 6 / height));
  }
  return static_cast<int>(cells.size());
}

TEST(FeatureDetector, GivesTheWantedNumberWellSpread) {
  const test::Picture picture = test::rectangles(640, 480, 500, 1);
  const test::Pyramid pyramid(picture.view());
  FeatureDetector detector(640, 480, {});
  const std::vector<Feature> features = detect(detector, pyramid.view(), {}, {}, 200);
  ASSERT_EQ(features.size(), 200u);
  std::vector<Vec2f> points;
  std::set<int> levels;
  for (std::size_t i = 0; i < features.size(); ++i) {
    const Feature& f = features[i];
    points.push_back(f.px);
    levels.insert(f.level);
    EXPECT_EQ(f.type, FeatureType::kCorner);
    EXPECT_GE(f.score, FeatureDetectorOptions{}.min_score);
    const Eigen::Vector2i at = on_level(f, f.level);
    const rt::ImageView& level = pyramid.view().level[static_cast<std::size_t>(f.level)];
    EXPECT_GE(std::min(at.x(), at.y()), 8);
    EXPECT_LT(at.x(), level.width - 8);
    EXPECT_LT(at.y(), level.height - 8);
    EXPECT_EQ(f.score, FeatureDetector::shi_tomasi_score(level, at.x(), at.y()));
    EXPECT_GT(fast_score(level, at.x(), at.y()), FeatureDetectorOptions{}.fast_threshold_min);
    for (std::size_t j = 0; j < i; ++j) EXPECT_GE((f.px - points[j]).norm(), 4.0f);
  }
  EXPECT_EQ(levels, (std::set<int>{0, 1, 2}));
  EXPECT_GE(occupied_cells(points, 640, 480), 46);
}

}  // namespace
}  // namespace godwit::vo
