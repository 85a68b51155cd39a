// Boxes followed by the picture inside them.
#include "firmware_app/dynamic/box_motion.h"

#include <cmath>
#include <gtest/gtest.h>
#include <vector>

namespace godwit::app {
namespace box_motion_test {

constexpr int kWidth = 320, kHeight = 240;

/// A textured rectangle at (x, y) before another texture.
std::vector<std::uint8_t> picture(double x0, double y0) {
  std::vector<std::uint8_t> p(static_cast<std::size_t>(kWidth * kHeight));
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      const double u = x - x0, v = y - y0;
      const bool inside = u >= 0 && u < 80 && v >= 0 && v < 120;
      const double grey = inside ? 120 + 60 * std::sin(0.21 * u + 0.05 * v) + 40 * std::cos(0.17 * v - 0.03 * u)
                                 : 90 + 30 * std::sin(0.13 * x) * std::cos(0.11 * y);
      p[static_cast<std::size_t>(y * kWidth + x)] = static_cast<std::uint8_t>(grey);
    }
  return p;
}

rt::ImageView view(const std::vector<std::uint8_t>& p) {
  return {p.data(), kWidth, kHeight, kWidth};
}

detector::Box box_at(float x, float y) {
  return {x, y, x + 80.F, y + 120.F, 0.9F, 0};
}

TEST(BoxMotion, FollowsWhatIsInsideToAPixelOrTwo) {
  for (const auto& [dx, dy] :
       {std::pair(0.0, 0.0), std::pair(9.0, -3.0), std::pair(-16.0, 8.0), std::pair(2.0, 20.0)}) {
    BoxMotion motion(kWidth, kHeight);
    const auto before = picture(100, 60), now = picture(100 + dx, 60 + dy);
    const std::vector<detector::Box> boxes = {box_at(100, 60)};
    EXPECT_TRUE(motion.next(view(before), boxes).empty()) << "one picture alone has no motion";
    const auto moved = motion.next(view(now), boxes);
    ASSERT_GE(moved.size(), 3u);
    for (const detector::FeatureMotion& m : moved) {
      EXPECT_NEAR(m.x - m.x_before, dx, 1.5);
      EXPECT_NEAR(m.y - m.y_before, dy, 1.5);
      EXPECT_GT(m.x_before, 100.F);
      EXPECT_LT(m.x_before, 180.F);
    }
  }
}

TEST(BoxMotion, ABoxFarBeyondThePictureIsFollowedByWhatIsSeenOfIt) {
  BoxMotion motion(kWidth, kHeight);
  const auto still = picture(100, 60);
  const std::vector<detector::Box> boxes = {{-2e10F, 0.F, 2e10F, 200.F, 0.9F, 0}};
  motion.next(view(still), boxes);
  EXPECT_FALSE(motion.next(view(still), boxes).empty());
}

TEST(BoxMotion, WhereNoMotionCanBeSeenNoneIsTold) {
  BoxMotion motion(kWidth, kHeight);
  const std::vector<std::uint8_t> grey(static_cast<std::size_t>(kWidth * kHeight), 90);
  const std::vector<detector::Box> boxes = {box_at(100, 60)};
  motion.next(view(grey), boxes);
  EXPECT_TRUE(motion.next(view(grey), boxes).empty());
}

TEST(BoxMotion, ABoxHalfOutsideIsFollowedByItsInside) {
  for (const auto& [x0, dx] : {std::pair(-30.0, 8.0), std::pair(270.0, -8.0)}) {
    BoxMotion motion(kWidth, kHeight);
    const auto before = picture(x0, 100), now = picture(x0 + dx, 108);
    const std::vector<detector::Box> boxes = {box_at(static_cast<float>(x0), 100)};
    motion.next(view(before), boxes);
    const auto moved = motion.next(view(now), boxes);
    ASSERT_FALSE(moved.empty());
    EXPECT_NEAR(moved[0].x - moved[0].x_before, dx, 1.5);
    EXPECT_NEAR(moved[0].y - moved[0].y_before, 8.0, 1.5);
  }
}

TEST(BoxMotion, BoxesWithoutAPictureInsideAreLeftOut) {
  BoxMotion motion(kWidth, kHeight);
  const auto p = picture(100, 60);
  const std::vector<detector::Box> boxes = {
      {10, 10, 14, 14, 1, 0}, {-500, -500, -400, -400, 1, 0}, {900, 900, 1000, 1000, 1, 0}, {50, 50, 40, 40, 1, 0}};
  motion.next(view(p), boxes);
  EXPECT_TRUE(motion.next(view(p), boxes).empty());
}

TEST(BoxMotion, ManyBoxesAreBounded) {
  BoxMotion motion(kWidth, kHeight);
  const auto p = picture(100, 60);
  const std::vector<detector::Box> boxes(1000, box_at(100, 60));
  motion.next(view(p), boxes);
  EXPECT_LE(motion.next(view(p), boxes).size(), 4u * BoxMotion::kMaxBoxes);
}

}  // namespace box_motion_test
}  // namespace godwit::app
