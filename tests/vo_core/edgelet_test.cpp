#include "vo_core/features/edgelet.h"

#include <cmath>
#include <gtest/gtest.h>
#include <numbers>

#include "tests/vo_core/synthetic_picture.h"

namespace godwit::vo {
namespace edgelet_test {

/// A soft straight edge through (32, 32), bright on the side of the angle.
test::Picture edge(double angle_rad, double slope) {
  test::Picture picture(64, 64, 0);
  for (int y = 0; y < 64; ++y) {
    for (int x = 0; x < 64; ++x) {
      const double d = (x - 32) * std::cos(angle_rad) + (y - 32) * std::sin(angle_rad);
      picture(x, y) = static_cast<std::uint8_t>(std::lround(128.0 + 50.0 * std::tanh(slope * d / 50.0)));
    }
  }
  return picture;
}

TEST(Edgelet, FindsTheEdgeItsDirectionAndItsSlope) {
  for (int i = 0; i < 16; ++i) {
    const double angle = i * std::numbers::pi / 8.0;
    const test::Picture picture = edge(angle, 12.0);
    Edgelet e;
    ASSERT_TRUE(find_edgelet(picture.view(), {}, 20, 20, 44, 44, 5.0f, &e));
    const Vec2f normal(static_cast<float>(std::cos(angle)), static_cast<float>(std::sin(angle)));
    EXPECT_GT(e.direction.dot(normal), 0.995f) << angle;
    EXPECT_NEAR(e.direction.norm(), 1.0f, 1e-5f);
    EXPECT_LT(std::abs(Vec2f(static_cast<float>(e.x - 32), static_cast<float>(e.y - 32)).dot(normal)), 1.0f);
    EXPECT_NEAR(e.magnitude, 12.0f, 1.0f);
  }
}

TEST(Edgelet, FlatOrMaskedGivesNone) {
  const test::Picture flat(64, 64, 77);
  Edgelet e;
  EXPECT_FALSE(find_edgelet(flat.view(), {}, 2, 2, 62, 62, 0.0f, &e));
  const test::Picture picture = edge(0.0, 12.0);
  EXPECT_FALSE(find_edgelet(picture.view(), {}, 2, 2, 62, 62, 20.0f, &e)) << "flatter than asked for";
  test::Picture mask(64, 64, 0);
  mask.fill_rectangle(0, 0, 64, 64, 1);
  EXPECT_FALSE(find_edgelet(picture.view(), mask.view(), 2, 2, 62, 62, 5.0f, &e));
  // The strongest pixel of a part beside the edge is no ridge.
  EXPECT_FALSE(find_edgelet(picture.view(), {}, 34, 10, 50, 50, 1.0f, &e));
  // One pixel left free.
  mask(32, 50) = 0;
  ASSERT_TRUE(find_edgelet(picture.view(), mask.view(), 2, 2, 62, 62, 5.0f, &e));
  EXPECT_EQ(e.x, 32);
  EXPECT_EQ(e.y, 50);
}

}  // namespace edgelet_test
}  // namespace godwit::vo
