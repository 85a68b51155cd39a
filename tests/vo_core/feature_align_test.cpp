#include "vo_core/features/feature_align.h"

#include <cmath>
#include <gtest/gtest.h>

#include "tests/vo_core/synthetic_picture.h"

namespace godwit::vo {
namespace feature_align_test {

double pattern(double x, double y) {
  return 120.0 + 40.0 * std::sin(0.55 * x + 0.2 * y) + 35.0 * std::cos(0.45 * y - 0.15 * x) +
         10.0 * std::sin(0.9 * (x + y));
}

test::Picture picture(double dx, double dy, double gain, double offset) {
  test::Picture p(64, 64, 0);
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 64; ++x)
      p(x, y) = static_cast<std::uint8_t>(std::clamp(std::lround(gain * pattern(x - dx, y - dy) + offset), 0L, 255L));
  return p;
}

ReferencePatch reference(double cx, double cy) {
  ReferencePatch r;
  for (int y = 0; y < kPatchBorderSize; ++y)
    for (int x = 0; x < kPatchBorderSize; ++x)
      r.value[static_cast<std::size_t>(y * kPatchBorderSize + x)] =
          static_cast<float>(pattern(cx + x - kPatchHalf - 1, cy + y - kPatchHalf - 1));
  return r;
}

FeatureAlignResult align_2d(const rt::ImageView& image, const ReferencePatch& ref, int max_iterations,
                            float max_shift_px, Vec2f* px) {
  AlignTemplate prepared;
  return prepare_align_2d(ref, &prepared) ? align(image, prepared, max_iterations, max_shift_px, px)
                                          : FeatureAlignResult{};
}

TEST(FeatureAlign, FindsASubPixelShift) {
  for (const Vec2f& shift : {Vec2f(0.37f, -0.61f), Vec2f(1.4f, 0.9f), Vec2f(-1.8f, 0.2f)}) {
    const test::Picture p = picture(shift.x(), shift.y(), 1.0, 0.0);
    Vec2f px(30.0f, 31.0f);
    const FeatureAlignResult r = align_2d(p.view(), reference(30, 31), 10, 4.0f, &px);
    ASSERT_TRUE(r.converged);
    EXPECT_NEAR(px.x(), 30.0f + shift.x(), 0.03f);
    EXPECT_NEAR(px.y(), 31.0f + shift.y(), 0.03f);
    EXPECT_LT(r.residual, 0.1f);
  }
}

TEST(FeatureAlign, BrightnessDoesNotMatter) {
  const test::Picture p = picture(0.8, -0.5, 0.6, 45.0);
  Vec2f px(30.0f, 31.0f);
  const FeatureAlignResult r = align_2d(p.view(), reference(30, 31), 12, 4.0f, &px);
  ASSERT_TRUE(r.converged);
  EXPECT_NEAR(px.x(), 30.8f, 0.04f);
  EXPECT_NEAR(px.y(), 30.5f, 0.04f);
  EXPECT_NEAR(r.gain, 0.6f, 0.05f);
}

TEST(FeatureAlign, AnEdgeIsFollowedAcrossOnly) {
  test::Picture p(64, 64, 0);
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 64; ++x)
      p(x, y) = static_cast<std::uint8_t>(std::lround(128.0 + 80.0 * std::tanh(0.5 * (x - 31.3))));
  ReferencePatch ref;
  for (int y = 0; y < kPatchBorderSize; ++y)
    for (int x = 0; x < kPatchBorderSize; ++x)
      ref.value[static_cast<std::size_t>(y * kPatchBorderSize + x)] =
          static_cast<float>(128.0 + 80.0 * std::tanh(0.5 * (x - kPatchHalf - 1)));
  Vec2f px(30.0f, 31.0f);
  AlignTemplate across;
  ASSERT_TRUE(prepare_align_1d(ref, Vec2f(1, 0), &across));
  ASSERT_TRUE(align(p.view(), across, 10, 4.0f, &px).converged);
  EXPECT_NEAR(px.x(), 31.3f, 0.03f);
  EXPECT_FLOAT_EQ(px.y(), 31.0f);
  px = Vec2f(30.0f, 31.0f);
  EXPECT_FALSE(align_2d(p.view(), ref, 10, 4.0f, &px).converged) << "along the edge nothing is known";
}

TEST(FeatureAlign, RefusesFlatPatchesTheEdgeOfThePictureAndTooLongWays) {
  ReferencePatch flat;
  flat.value.fill(100.0f);
  const test::Picture p = picture(0, 0, 1, 0);
  Vec2f px(30.0f, 31.0f);
  EXPECT_FALSE(align_2d(p.view(), flat, 10, 4.0f, &px).converged);
  Vec2f edge(2.0f, 31.0f);
  EXPECT_FALSE(align_2d(p.view(), reference(2, 31), 10, 4.0f, &edge).converged);
  Vec2f far(30.0f, 31.0f);
  EXPECT_FALSE(align_2d(picture(2.0, 0, 1, 0).view(), reference(30, 31), 10, 0.5f, &far).converged);
  EXPECT_EQ(far, Vec2f(30.0f, 31.0f)) << "a failure leaves the place as it was";
}

}  // namespace feature_align_test
}  // namespace godwit::vo
