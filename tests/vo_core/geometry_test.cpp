#include "vo_core/geometry/geometry.h"

#include <gtest/gtest.h>

namespace godwit::vo {
namespace geometry_test {

TEST(Geometry, ExpAndLogOfRigidMotionsUndoEachOther) {
  for (const double angle : {0.0, 1e-9, 1e-4, 0.3, 2.0, 3.0}) {
    Vec6 x;
    x << 0.3, -1.2, 0.7, angle * Vec3(0.6, -0.64, 0.48);
    EXPECT_LT((SE3::exp(x).log() - x).norm(), 1e-9) << "angle " << angle;
  }
}

TEST(Geometry, AnAngleIsExactFromNothingToAHalfTurn) {
  EXPECT_EQ(angle_between(Vec3::UnitX(), Vec3::UnitX()), 0.0);
  EXPECT_NEAR(angle_between(Vec3(2, 0, 0), Vec3(3, 3e-10, 0)) / 1e-10, 1.0, 1e-9);
  EXPECT_NEAR(angle_between(Vec3::UnitX(), Vec3(0, 5, 0)), M_PI / 2, 1e-15);
  EXPECT_NEAR(angle_between(Vec3::UnitZ(), -Vec3::UnitZ()), M_PI, 1e-15);
}

TEST(Geometry, InverseUndoesAMotion) {
  Vec6 x;
  x << 1, 2, 3, 0.4, -0.5, 0.6;
  const SE3 T = SE3::exp(x);
  const Vec3 p(0.1, -0.2, 5.0);
  EXPECT_LT((T.inverse() * (T * p) - p).norm(), 1e-12);
  EXPECT_LT(((T * T.inverse()).R - Mat3::Identity()).norm(), 1e-12);
}

}  // namespace geometry_test
}  // namespace godwit::vo
