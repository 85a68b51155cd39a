#include "vo_core/features/feature_detector.h"

#include <algorithm>
#include <cmath>
#include <gtest/gtest.h>
#include <set>
#include <vector>

#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"
#include "tests/vo_core/plain_fast.h"
#include "tests/vo_core/synthetic_picture.h"
#include "vo_core/features/fast_corner.h"
#include "vo_core/features/shi_tomasi.h"

namespace godwit::vo {
namespace feature_detector_test {

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

std::vector<Vec2f> pixels(const std::vector<Feature>& features) {
  std::vector<Vec2f> points;
  points.reserve(features.size());
  for (const Feature& f : features) points.push_back(f.px);
  return points;
}

int corners(const std::vector<Feature>& features) {
  return static_cast<int>(
      std::count_if(features.begin(), features.end(), [](const Feature& f) { return f.type == FeatureType::kCorner; }));
}

TEST(FeatureDetector, GivesTheWantedNumberWellSpread) {
  const test::Picture picture = test::rectangles(640, 480, 500, 1);
  const test::Pyramid pyramid(picture.view());
  FeatureDetector detector(640, 480, {});
  const std::vector<Feature> features = detect(detector, pyramid.view(), {}, {}, 200);
  ASSERT_EQ(features.size(), 200u);
  const std::vector<Vec2f> points = pixels(features);
  std::set<int> levels;
  for (std::size_t i = 0; i < features.size(); ++i) {
    const Feature& f = features[i];
    levels.insert(f.level);
    EXPECT_EQ(f.type, FeatureType::kCorner);
    EXPECT_GE(f.score, FeatureDetectorOptions{}.min_score * grey_noise_at(detector.noise(), f.level) *
                           grey_noise_at(detector.noise(), f.level));
    const Eigen::Vector2i at = on_level(f, f.level);
    const rt::ImageView& level = pyramid.view().level[static_cast<std::size_t>(f.level)];
    EXPECT_GE(std::min(at.x(), at.y()), 8);
    EXPECT_LT(at.x(), level.width - 8);
    EXPECT_LT(at.y(), level.height - 8);
    EXPECT_EQ(f.score, shi_tomasi(level, at.x(), at.y()));
    EXPECT_GT(fast_score(level, at.x(), at.y()), static_cast<int>(2.5f * grey_noise_at(detector.noise(), f.level)));
    for (std::size_t j = 0; j < i; ++j) EXPECT_GE((f.px - points[j]).norm(), 4.0f);
  }
  EXPECT_EQ(levels, (std::set<int>{0, 1, 2}));
  EXPECT_GE(test::occupied_cells(points, 640, 480), 46);
}

TEST(FeatureDetector, FindsACornerWhereItIsAndOnce) {
  // One bright square on grey: four corners, seen on every level, to be taken once each.
  test::Picture picture(320, 240, 60);
  picture.fill_rectangle(100, 80, 180, 150, 200);
  picture.blur();
  const test::Pyramid pyramid(picture.view());
  FeatureDetector detector(320, 240, {.edgelets = false});
  const std::vector<Feature> features = detect(detector, pyramid.view(), {}, {}, 50);
  ASSERT_EQ(features.size(), 4u);
  for (const Vec2f& truth : {Vec2f(99.5f, 79.5f), Vec2f(179.5f, 79.5f), Vec2f(99.5f, 149.5f), Vec2f(179.5f, 149.5f)}) {
    float nearest = 1e9f;
    for (const Feature& f : features) nearest = std::min(nearest, (f.px - truth).norm());
    EXPECT_LT(nearest, 3.0f) << truth.transpose();
  }
}

TEST(FeatureDetector, SearchesTheLevelsItIsAskedTo) {
  const test::Picture picture = test::rectangles(320, 240, 120, 3);
  const test::Pyramid pyramid(picture.view());
  for (int levels = 1; levels <= rt::kPyramidLevels; ++levels) {
    FeatureDetector detector(320, 240, {.levels = levels});
    std::set<int> found;
    for (const Feature& f : detect(detector, pyramid.view(), {}, {}, 150)) found.insert(f.level);
    EXPECT_EQ(*found.begin(), 0);
    EXPECT_LT(*found.rbegin(), levels);
    EXPECT_GE(static_cast<int>(found.size()), std::min(levels, 3));
  }
}

TEST(FeatureDetector, LowersTheThresholdOnlyWhereTextureIsWeak) {
  // Left: strong squares. Right: squares of 16 grey levels, whose corners FAST misses at 20.
  test::Picture picture(640, 480, 100);
  for (int y = 30; y < 450; y += 40) {
    for (int x = 30; x < 610; x += 40) picture.fill_rectangle(x, y, x + 20, y + 20, x < 320 ? 220 : 116);
  }
  const test::Pyramid pyramid(picture.view());
  FeatureDetector detector(640, 480, {.edgelets = false});
  int weak = 0, strong = 0;
  for (const Feature& f : detect(detector, pyramid.view(), {}, {}, 300)) {
    const Eigen::Vector2i at = on_level(f, f.level);
    const int score = fast_score(pyramid.view().level[static_cast<std::size_t>(f.level)], at.x(), at.y());
    if (f.px.x() < 310) {
      EXPECT_GT(score, 20);
      ++strong;
    } else if (f.px.x() > 330) {
      EXPECT_LE(score, 20);
      ++weak;
    }
  }
  EXPECT_GT(strong, 80);
  EXPECT_GT(weak, 80);
}

TEST(FeatureDetector, OccupiedPlacesGiveNothingNew) {
  const test::Picture picture = test::rectangles(640, 480, 500, 5);
  const test::Pyramid pyramid(picture.view());
  FeatureDetector detector(640, 480, {});
  const std::vector<Vec2f> first = pixels(detect(detector, pyramid.view(), {}, {}, 100));
  ASSERT_EQ(first.size(), 100u);
  const std::vector<Feature> second = detect(detector, pyramid.view(), {}, first, 100);
  EXPECT_EQ(second.size(), 100u);
  for (const Feature& f : second) {
    for (const Vec2f& px : first) EXPECT_GT((f.px - px).norm(), 4.0f);
  }
  // Places outside the picture and NaN are no places.
  const float nan = std::nanf("");
  const std::vector<Vec2f> nowhere{{-5.0f, 10.0f}, {1e9f, 10.0f}, {nan, nan}, {3.0f, -1e30f}};
  EXPECT_EQ(pixels(detect(detector, pyramid.view(), {}, nowhere, 100)), first);
}

TEST(FeatureDetector, NewFeaturesGoWhereNoneAre) {
  const test::Picture picture = test::rectangles(640, 480, 500, 6);
  const test::Pyramid pyramid(picture.view());
  FeatureDetector detector(640, 480, {});
  // The left half is full already: a feature every 10 px.
  std::vector<Vec2f> occupied;
  for (int y = 5; y < 480; y += 10) {
    for (int x = 5; x < 320; x += 10) occupied.emplace_back(static_cast<float>(x), static_cast<float>(y));
  }
  const std::vector<Feature> features = detect(detector, pyramid.view(), {}, occupied, 60);
  EXPECT_EQ(features.size(), 60u);
  for (const Feature& f : features) EXPECT_GE(f.px.x(), 310.0f);
}

TEST(FeatureDetector, EdgeletsFillWhatCornersLeaveOpen) {
  // Long edges, no corner but those of the frame's border.
  test::Picture picture(640, 480, 70);
  for (int x = 0; x < 640; x += 80) picture.fill_rectangle(x, 0, x + 40, 480, 170);
  picture.blur();
  const test::Pyramid pyramid(picture.view());
  FeatureDetector with(640, 480, {}), without(640, 480, {.edgelets = false});
  EXPECT_TRUE(detect(without, pyramid.view(), {}, {}, 120).empty());
  const std::vector<Feature> features = detect(with, pyramid.view(), {}, {}, 120);
  ASSERT_EQ(features.size(), 120u);
  for (std::size_t i = 0; i < features.size(); ++i) {
    const Feature& f = features[i];
    ASSERT_EQ(f.type, FeatureType::kEdgelet);
    EXPECT_GT(std::abs(f.gradient.x()), 0.99f);
    EXPECT_GE(f.score, 6.0f);
    const float to_edge = std::remainder(f.px.x() + 0.5f, 40.0f);
    EXPECT_LT(std::abs(to_edge), 1.5f * static_cast<float>(1 << f.level)) << f.px.transpose();
    for (std::size_t j = 0; j < i; ++j) EXPECT_GE((f.px - features[j].px).norm(), 4.0f);
  }
  // Masked edges give none, and places that exist stay alone.
  test::Mask mask(640, 480);
  mask.add_rectangle(0, 0, 640, 240);
  const std::vector<Vec2f> occupied{features[0].px, features[1].px};
  for (const Feature& f : detect(with, pyramid.view(), mask.view(), occupied, 120)) {
    EXPECT_GE(f.px.y(), 240.0f);
    for (const Vec2f& px : occupied) EXPECT_GE((f.px - px).norm(), 4.0f);
  }
}

TEST(FeatureDetector, FlatPictureGivesNothing) {
  const test::Picture picture(640, 480, 128);
  const test::Pyramid pyramid(picture.view());
  FeatureDetector detector(640, 480, {});
  EXPECT_TRUE(detect(detector, pyramid.view(), {}, {}, 100).empty());
}

TEST(FeatureDetector, SmallPicturesAndSizesThatDoNotDivide) {
  for (const auto& [width, height] : {std::pair(32, 32), std::pair(641, 479), std::pair(129, 67)}) {
    test::Picture picture = test::rectangles(width, height, 60, 9);
    picture.fill_rectangle(width / 2 - 5, height / 2 - 5, width / 2 + 5, height / 2 + 5, 10);
    picture.fill_rectangle(width / 2 - 3, height / 2 - 3, width / 2 + 3, height / 2 + 3, 250);
    const test::Pyramid pyramid(picture.view(), 3);
    FeatureDetector detector(width, height, {});
    const std::vector<Feature> features = detect(detector, pyramid.view(), {}, {}, 5000);
    EXPECT_FALSE(features.empty());
    for (const Feature& f : features) {
      EXPECT_GE(std::min(f.px.x(), f.px.y()), 8.0f);
      EXPECT_LT(f.px.x(), static_cast<float>(width - 8));
      EXPECT_LT(f.px.y(), static_cast<float>(height - 8));
    }
  }
}

// The paper, section 2.3: 36 % of the picture hidden by movers.
TEST(FeatureDetector, QuadtreeAgainstPlainFastUnderAMask) {
  // Texture of uneven strength, so that the strongest corners crowd in one part.
  test::Picture picture = test::rectangles(640, 480, 500, 12);
  for (int y = 0; y < 480; ++y) {
    for (int x = 0; x < 640; ++x) {
      const int contrast = x < 220 && y < 200 ? 100 : 35;
      picture(x, y) = static_cast<std::uint8_t>(128 + (picture(x, y) - 128) * contrast / 100);
    }
  }
  const test::Pyramid pyramid(picture.view());
  const test::Mask mask = test::two_walkers(640, 480);
  ASSERT_GE(mask.share(), 0.36);
  ASSERT_LE(mask.share(), 0.38);
  FeatureDetector detector(640, 480, {});
  for (const int wanted : {100, 200, 300}) {
    const std::vector<Feature> features = detect(detector, pyramid.view(), mask.view(), {}, wanted);
    EXPECT_GE(corners(features), wanted * 95 / 100);
    for (const Feature& f : features) {
      for (const int level : {0, static_cast<int>(f.level)}) {
        const rt::ImageView m = mask.view().level[static_cast<std::size_t>(level)];
        const Eigen::Vector2i at = on_level(f, level);
        EXPECT_EQ(m.at(at.x(), at.y()), 0) << f.px.transpose() << " level " << level;
      }
    }
    const std::vector<Vec2f> plain = test::plain_fast(picture.view(), mask.view().level[0], wanted);
    ASSERT_EQ(plain.size(), static_cast<std::size_t>(wanted));
    EXPECT_GT(test::occupied_cells(pixels(features), 640, 480), test::occupied_cells(plain, 640, 480));
  }
}

TEST(FeatureDetector, LevelsThatTheMaskDoesNotCoverAreNotSearched) {
  const test::Picture picture = test::rectangles(640, 480, 500, 13);
  const test::Pyramid pyramid(picture.view());
  const test::Mask one_level(640, 480, 1);
  FeatureDetector detector(640, 480, {});
  for (const Feature& f : detect(detector, pyramid.view(), one_level.view(), {}, 200)) EXPECT_EQ(f.level, 0);
}

TEST(FeatureDetector, AllMaskedGivesNothing) {
  const test::Picture picture = test::rectangles(640, 480, 500, 14);
  const test::Pyramid pyramid(picture.view());
  test::Mask mask(640, 480);
  mask.add_rectangle(0, 0, 640, 480);
  FeatureDetector detector(640, 480, {});
  EXPECT_TRUE(detect(detector, pyramid.view(), mask.view(), {}, 200).empty());
}

TEST(FeatureDetector, DependsOnThePictureAloneAndNotOnWhatCameBefore) {
  const test::Picture a = test::rectangles(640, 480, 500, 15), b = test::rectangles(640, 480, 40, 16);
  const test::Pyramid pa(a.view()), pb(b.view());
  FeatureDetector used(640, 480, {}), fresh(640, 480, {});
  detect(used, pb.view(), {}, {Vec2f(100, 100)}, 400);
  const std::vector<Feature> first = detect(used, pa.view(), {}, {}, 200),
                             second = detect(fresh, pa.view(), {}, {}, 200);
  ASSERT_EQ(first.size(), second.size());
  for (std::size_t i = 0; i < first.size(); ++i) {
    EXPECT_EQ(first[i].px, second[i].px);
    EXPECT_EQ(first[i].score, second[i].score);
  }
}

TEST(FeatureDetector, DoesNotAllocate) {
  const test::Picture rich = test::rectangles(640, 480, 500, 17), poor = test::rectangles(640, 480, 6, 18);
  const test::Mask mask = test::two_walkers(640, 480);
  FeatureDetector detector(640, 480, {});
  std::vector<Feature> features(1000);
  const std::vector<Vec2f> occupied(50, Vec2f(300.0f, 200.0f));
  for (const test::Picture* picture : {&rich, &poor}) {
    const test::Pyramid pyramid(picture->view());
    const rt::MaskPyramidView view = mask.view();
    const rt::HeapCounts before = rt::rt_heap_counts();
    {
      const rt::RtScope scope;
      EXPECT_GT(detector.detect(pyramid.view(), view, occupied, 1000, features), 0);
    }
    EXPECT_EQ(rt::rt_heap_counts().allocations, before.allocations);
    EXPECT_EQ(rt::rt_heap_counts().frees, before.frees);
  }
}

}  // namespace feature_detector_test
}  // namespace godwit::vo
