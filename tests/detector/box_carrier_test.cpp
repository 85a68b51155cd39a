#include "detector/box_carrier.h"

#include <gtest/gtest.h>
#include <limits>
#include <vector>

namespace godwit::detector::box_carrier_test {
namespace {

constexpr std::int64_t kFrame = 33'000'000;
const Box kBox{100.F, 100.F, 200.F, 300.F, 0.8F, 0};

CarrierLimits no_growth() {
  CarrierLimits limits;
  limits.growth_per_s = 0.F;
  return limits;
}

/// A grid of features in a box, scaled about its centre and moved.
std::vector<FeatureMotion> grid(const Box& b, float dx, float dy, float scale = 1.F) {
  std::vector<FeatureMotion> out;
  const float cx = 0.5F * (b.x0 + b.x1), cy = 0.5F * (b.y0 + b.y1);
  for (int i = 1; i < 6; ++i) {
    for (int j = 1; j < 6; ++j) {
      const float x = b.x0 + b.width() * static_cast<float>(i) / 6.F,
                  y = b.y0 + b.height() * static_cast<float>(j) / 6.F;
      out.push_back({x, y, cx + (x - cx) * scale + dx, cy + (y - cy) * scale + dy});
    }
  }
  return out;
}

TEST(BoxCarrier, GoesWithTheFeaturesInTheBox) {
  BoxCarrier carrier(640, 480, no_growth());
  ASSERT_TRUE(carrier.advance(0, {}, {}));
  ASSERT_TRUE(carrier.replace(0, {&kBox, 1}));
  carrier.advance(kFrame, grid(kBox, 5.F, -3.F), {});
  ASSERT_EQ(carrier.boxes().size(), 1U);
  EXPECT_NEAR(carrier.boxes()[0].x0, 105.F, 1e-3);
  EXPECT_NEAR(carrier.boxes()[0].y1, 297.F, 1e-3);
  EXPECT_EQ(carrier.age_ns(), kFrame);
}

TEST(BoxCarrier, AFewFeaturesOfTheBackgroundDoNotHoldItBack) {
  BoxCarrier carrier(640, 480, no_growth());
  carrier.advance(0, {}, {});
  carrier.replace(0, {&kBox, 1});
  auto features = grid(kBox, 6.F, 0.F);
  for (std::size_t i = 0; i < 10; ++i) features[i].x = features[i].x_before;
  carrier.advance(kFrame, features, {});
  EXPECT_NEAR(carrier.boxes()[0].x0, 106.F, 1.F);
}

TEST(BoxCarrier, GrowsWithWhatComesNearer) {
  BoxCarrier carrier(640, 480, no_growth());
  carrier.advance(0, {}, {});
  carrier.replace(0, {&kBox, 1});
  carrier.advance(kFrame, grid(kBox, 0.F, 0.F, 1.05F), {});
  EXPECT_NEAR(carrier.boxes()[0].width(), 105.F, 0.1F);
  EXPECT_NEAR(carrier.boxes()[0].height(), 210.F, 0.1F);
}

TEST(BoxCarrier, WithoutFeaturesGoesWithTheCamera) {
  BoxCarrier carrier(640, 480, no_growth());
  carrier.advance(0, {}, {});
  carrier.replace(0, {&kBox, 1});
  CameraMotion pan;
  pan.far_homography[2] = 12.F;
  carrier.advance(kFrame, {}, pan);
  EXPECT_NEAR(carrier.boxes()[0].x0, 112.F, 1e-3);
  CameraMotion broken;
  broken.far_homography = {0, 0, 0, 0, 0, 0, 0, 0, -1.F};
  carrier.advance(2 * kFrame, {}, broken);
  EXPECT_NEAR(carrier.boxes()[0].x0, 112.F, 1e-3);
}

TEST(BoxCarrier, ALateDetectionCatchesUp) {
  BoxCarrier carrier(640, 480, no_growth());
  CameraMotion pan;
  pan.far_homography[2] = 4.F;
  for (int i = 0; i < 6; ++i) carrier.advance(i * kFrame, {}, pan);
  // Seen in picture 2, comes after picture 5: three steps to go.
  ASSERT_TRUE(carrier.replace(2 * kFrame, {&kBox, 1}));
  EXPECT_NEAR(carrier.boxes()[0].x0, 112.F, 1e-3);
  EXPECT_EQ(carrier.age_ns(), 3 * kFrame);
  EXPECT_FALSE(carrier.replace(kFrame, {&kBox, 1})) << "older than what is held";
  EXPECT_FALSE(carrier.replace(9 * kFrame, {&kBox, 1})) << "from a picture that has not come yet";
}

TEST(BoxCarrier, ALateDetectionTellsOfThePicturesSinceThen) {
  BoxCarrier carrier(640, 480, no_growth());
  std::span<const Box> boxes;
  carrier.advance(0, {}, {});
  EXPECT_FALSE(carrier.boxes_at(0, &boxes)) << "no detection yet";
  carrier.advance(kFrame, {}, {});
  carrier.advance(2 * kFrame, grid(kBox, 5.F, 0.F), {});
  carrier.advance(3 * kFrame, grid({105.F, 100.F, 205.F, 300.F, 0.8F, 0}, 5.F, 0.F), {});
  carrier.replace(kFrame, {&kBox, 1});
  EXPECT_FALSE(carrier.boxes_at(0, &boxes)) << "before the detection";
  for (int i = 1; i <= 3; ++i) {
    ASSERT_TRUE(carrier.boxes_at(i * kFrame, &boxes));
    ASSERT_EQ(boxes.size(), 1U);
    EXPECT_NEAR(boxes[0].x0, 100.F + 5.F * static_cast<float>(i - 1), 1e-3);
  }
  EXPECT_FALSE(carrier.boxes_at(4 * kFrame, &boxes)) << "not seen yet";
  // Nothing was found in a later picture: of it, and of it alone, nothing is known to move.
  carrier.replace(3 * kFrame, {});
  EXPECT_FALSE(carrier.boxes_at(2 * kFrame, &boxes));
  ASSERT_TRUE(carrier.boxes_at(3 * kFrame, &boxes));
  EXPECT_TRUE(boxes.empty());
}

TEST(BoxCarrier, ADetectionOlderThanTheHistoryIsRefused) {
  BoxCarrier carrier(640, 480);
  for (int i = 0; i < BoxCarrier::kHistory + 2; ++i) carrier.advance(i * kFrame, {}, {});
  EXPECT_FALSE(carrier.replace(kFrame, {&kBox, 1}));
  EXPECT_TRUE(carrier.replace(2 * kFrame, {&kBox, 1}));
}

TEST(BoxCarrier, GrowsWithAgeAndDiesWhenStale) {
  CarrierLimits limits;
  limits.growth_per_s = 0.4F;
  limits.max_growth_share = 0.2F;
  limits.max_age_ns = 1'000'000'000;
  BoxCarrier carrier(640, 480, limits);
  carrier.advance(0, {}, {});
  carrier.replace(0, {&kBox, 1});
  carrier.advance(250'000'000, {}, {});
  EXPECT_NEAR(carrier.boxes()[0].width(), 110.F, 1e-2);
  carrier.advance(1'000'000'000, {}, {});
  ASSERT_EQ(carrier.boxes().size(), 1U);
  EXPECT_NEAR(carrier.boxes()[0].width(), 120.F, 1e-2) << "growth has an end";
  carrier.advance(1'000'000'001, {}, {});
  EXPECT_TRUE(carrier.boxes().empty());
}

TEST(BoxCarrier, LeavesThePicture) {
  BoxCarrier carrier(640, 480);
  carrier.advance(0, {}, {});
  carrier.replace(0, {&kBox, 1});
  CameraMotion pan;
  pan.far_homography[2] = -250.F;
  carrier.advance(kFrame, {}, pan);
  EXPECT_TRUE(carrier.boxes().empty());
}

TEST(BoxCarrier, WhatThePictureCutsOffComesIntoView) {
  BoxCarrier carrier(640, 480, no_growth());
  carrier.advance(0, {}, {});
  // Half of somebody at the left edge, cut off below as well; another one wholly inside.
  const Box boxes[] = {{1.F, 100.F, 60.F, 479.F, 0.8F, 0}, {300.F, 100.F, 400.F, 300.F, 0.8F, 0}};
  carrier.replace(0, boxes);
  auto features = grid(boxes[0], 20.F, -10.F);
  const auto other = grid(boxes[1], 20.F, -10.F);
  features.insert(features.end(), other.begin(), other.end());
  carrier.advance(kFrame, features, {});
  ASSERT_EQ(carrier.boxes().size(), 2U);
  const Box& entering = carrier.boxes()[0];
  EXPECT_FLOAT_EQ(entering.x0, 0.F) << "more of him is to the left";
  EXPECT_FLOAT_EQ(entering.y1, 480.F);
  EXPECT_NEAR(entering.x1, 80.F, 1.F);
  EXPECT_NEAR(entering.y0, 90.F, 1.F);
  EXPECT_NEAR(carrier.boxes()[1].x0, 320.F, 1e-3);
  // What is stretched does not slow down what is followed: the motion is looked for where he was seen.
  ASSERT_EQ(carrier.followed().size(), 2U);
  EXPECT_NEAR(carrier.followed()[0].x0, 21.F, 1.F);
  EXPECT_NEAR(carrier.followed()[0].width(), 59.F, 1.F);
  // A late detection that sees him whole lets go of the edge.
  const Box whole{30.F, 90.F, 110.F, 470.F, 0.8F, 0};
  carrier.replace(kFrame, {&whole, 1});
  carrier.advance(2 * kFrame, grid(whole, 20.F, 0.F), {});
  EXPECT_NEAR(carrier.boxes()[0].x0, 50.F, 1e-3);
}

TEST(BoxCarrier, BadInputIsLeftOut) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  BoxCarrier carrier(640, 480, no_growth());
  EXPECT_FALSE(carrier.replace(0, {&kBox, 1})) << "no picture yet";
  EXPECT_EQ(carrier.age_ns(), INT64_MAX);
  carrier.advance(0, {}, {});
  EXPECT_FALSE(carrier.advance(0, {}, {})) << "time must rise";
  const Box boxes[] = {{nan, 0, 1, 1, 1, 0}, kBox, {10, 10, 5, 20, 1, 0}};
  ASSERT_TRUE(carrier.replace(0, boxes));
  ASSERT_EQ(carrier.boxes().size(), 1U);
  std::vector<FeatureMotion> features(2000, {nan, 150.F, nan, 150.F});
  carrier.advance(kFrame, features, {});
  ASSERT_EQ(carrier.boxes().size(), 1U);
  EXPECT_FLOAT_EQ(carrier.boxes()[0].x0, 100.F);
}

}  // namespace
}  // namespace godwit::detector::box_carrier_test
