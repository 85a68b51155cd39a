#include "vo_core/image/grey_noise.h"

#include <algorithm>
#include <cmath>
#include <gtest/gtest.h>
#include <random>

#include "tests/vo_core/synthetic_scene.h"
#include "vo_core/features/feature_detector.h"

namespace godwit::vo {
namespace grey_noise_test {

using namespace test;  // NOLINT: the pictures of this folder's tests

Picture with_noise(Picture picture, double sigma) {
  std::mt19937 rng(7);
  std::normal_distribution<double> noise(0.0, sigma);
  for (int y = 0; y < picture.view().height; ++y)
    for (int x = 0; x < picture.view().width; ++x)
      picture(x, y) = static_cast<std::uint8_t>(std::clamp(std::lround(picture(x, y) + noise(rng)), 0L, 255L));
  return picture;
}

Picture textured() {
  Picture picture(640, 480, 0);
  for (int y = 0; y < 480; ++y)
    for (int x = 0; x < 640; ++x)
      picture(x, y) = static_cast<std::uint8_t>(std::lround(60.0 + 120.0 * texture(x / 20.0, y / 20.0, 3)));
  return picture;
}

TEST(GreyNoise, IsFoundInFlatAndInTexturedPictures) {
  for (const double sigma : {1.5, 3.0, 6.0}) {
    EXPECT_NEAR(static_cast<double>(grey_noise(with_noise(Picture(640, 480, 120), sigma).view())), sigma, 0.1 * sigma);
    EXPECT_NEAR(static_cast<double>(grey_noise(with_noise(textured(), sigma).view())), sigma, 0.15 * sigma);
  }
}

TEST(GreyNoise, IsNeverBelowWhatRoundingAndCompressionLeave) {
  EXPECT_EQ(grey_noise(Picture(640, 480, 120).view()), kLeastGreyNoise);
  EXPECT_EQ(grey_noise(Picture(640, 480, 0).view()), kLeastGreyNoise);
  EXPECT_EQ(grey_noise(Picture(16, 16, 120).view()), kLeastGreyNoise) << "smaller than a block";
  EXPECT_GE(grey_noise(Picture(4000, 3000, 120).view()), kLeastGreyNoise) << "more blocks than are looked at";
}

TEST(GreyNoise, OfBlocksAtTheEndOfTheScaleIsNotCounted) {
  Picture picture = with_noise(Picture(640, 480, 120), 3.0);
  picture.fill_rectangle(0, 0, 320, 480, 255);
  EXPECT_NEAR(static_cast<double>(grey_noise(picture.view())), 3.0, 0.3);
}

// Snow, a white wall: corners of a few grey levels, which limits made for streets do not see.
TEST(GreyNoise, FaintTextureHasFeaturesAndItsNoiseAloneHasFew) {
  Picture faint(640, 480, 0);
  for (int y = 0; y < 480; ++y)
    for (int x = 0; x < 640; ++x)
      faint(x, y) = static_cast<std::uint8_t>(std::lround(110.0 + 24.0 * texture(x / 10.0, y / 10.0, 3)));
  std::vector<Feature> out(160);
  FeatureDetector detector(640, 480, {.edgelets = false});
  const Picture snow = with_noise(faint, 1.5), fog = with_noise(Picture(640, 480, 120), 1.5);
  const Pyramid quiet(snow.view());
  EXPECT_GT(detector.detect(quiet.view(), {}, {}, 160, out), 120);
  const Pyramid nothing(fog.view());
  EXPECT_LT(detector.detect(nothing.view(), {}, {}, 160, out), 10);
}

}  // namespace grey_noise_test
}  // namespace godwit::vo
