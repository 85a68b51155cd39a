#include "vo_core/features/shi_tomasi.h"

#include <Eigen/Eigenvalues>
#include <gtest/gtest.h>

#include "tests/vo_core/synthetic_picture.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::vo {
namespace shi_tomasi_test {

/// The definition, in floating point, eigenvalue by Eigen.
double reference(const rt::ImageView& image, int x, int y) {
  Eigen::Matrix2d tensor = Eigen::Matrix2d::Zero();
  for (int v = y - 4; v < y + 4; ++v) {
    for (int u = x - 4; u < x + 4; ++u) {
      const Vec2 g(0.5 * (image.at(u + 1, v) - image.at(u - 1, v)), 0.5 * (image.at(u, v + 1) - image.at(u, v - 1)));
      tensor += g * g.transpose() / 64.0;
    }
  }
  return Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(tensor).eigenvalues()(0);
}

TEST(ShiTomasi, EqualsTheDefinition) {
  const test::Picture picture = test::rectangles(120, 90, 30, 6);
  for (int y = 5; y < 85; ++y) {
    for (int x = 5; x < 115; ++x) {
      const double expected = reference(picture.view(), x, y);
      ASSERT_NEAR(shi_tomasi(picture.view(), x, y), expected, 1e-3 + 1e-5 * expected) << x << " " << y;
    }
  }
}

TEST(ShiTomasi, FlatAndStraightEdgesScoreNothing) {
  test::Picture picture(40, 40, 90);
  EXPECT_EQ(shi_tomasi(picture.view(), 20, 20), 0.0f);
  picture.fill_rectangle(20, 0, 40, 40, 200);
  EXPECT_NEAR(shi_tomasi(picture.view(), 20, 20), 0.0f, 1e-4f);
  picture.fill_rectangle(0, 20, 40, 40, 10);
  EXPECT_GT(shi_tomasi(picture.view(), 20, 20), 100.0f);
}

TEST(ShiTomasi, ZeroWhereThePatchLeavesThePicture) {
  // Exactly as large as needed for one pixel: the address sanitizer sees a read outside.
  test::Picture picture(11, 11, 0);
  picture.add_noise(100.0, 1);
  EXPECT_GT(shi_tomasi(picture.view(), 5, 5), 0.0f);
  for (int i = 0; i < 11; ++i) {
    if (i == 5) continue;
    EXPECT_EQ(shi_tomasi(picture.view(), i, 5), 0.0f);
    EXPECT_EQ(shi_tomasi(picture.view(), 5, i), 0.0f);
  }
}

}  // namespace shi_tomasi_test
}  // namespace godwit::vo
