#include "vo_core/geometry/rolling_shutter.h"

#include <gtest/gtest.h>

#include "tests/vo_core/test_cameras.h"

namespace godwit::vo {
namespace rolling_shutter_test {

// What a rolling shutter really sees: the row at which the point appears decides when, by iteration.
TEST(RollingShutter, FirstOrderModelFollowsTheExactOne) {
  const CameraModel camera = test::tum_fr1();
  const RollingShutter shutter{0.0233, 0.5};
  Vec6 velocity;
  velocity << 0.4, -0.2, 0.1, 0.2, -0.3, 0.1;
  ReadoutMotion motion;
  motion.velocity = velocity;
  for (const Vec2& start : {Vec2(60, 40), Vec2(320, 240), Vec2(600, 450)}) {
    const Vec3 p = camera.unproject(start) * 1.2;
    Vec2 global, seen;
    Mat23 J;
    ASSERT_TRUE(camera.project(p, &global, &J));
    seen = global;
    for (int i = 0; i < 20; ++i) {
      const double tau = (seen.y() / camera.height() - shutter.reference) * shutter.readout_s;
      ASSERT_TRUE(camera.project(SE3::exp(velocity * tau) * p, &seen));
    }
    const Vec2 modelled = global + rolling_displacement(shutter, camera.height(), p, J, seen.y(), motion);
    EXPECT_LT((modelled - seen).norm(), 0.03 + 0.02 * (seen - global).norm());
  }
}

TEST(RollingShutter, TheReferenceRowDoesNotMove) {
  const CameraModel camera = test::tum_fr1();
  const Vec3 p(0.3, 0.0, 2.0);
  Vec2 px;
  Mat23 J;
  ASSERT_TRUE(camera.project(p, &px, &J));
  ReadoutMotion motion;
  motion.velocity = Vec6::Ones();
  EXPECT_LT(rolling_displacement({0.02, 0.5}, 480, p, J, 240.0, motion).norm(), 1e-12);
}

}  // namespace rolling_shutter_test
}  // namespace godwit::vo
