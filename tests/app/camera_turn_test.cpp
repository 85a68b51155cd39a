// The camera's turn to the next picture, as boxes are carried with it.
#include "firmware_app/dynamic/camera_turn.h"

#include <gtest/gtest.h>

namespace godwit::app {
namespace camera_turn_test {

constexpr rt::TimeNs kFrame = 33 * rt::kNsPerMs;

const vo::CameraModel& camera() {
  static const vo::CameraModel made = vo::CameraModel::pinhole_radtan(640, 480, 500, 500, 319.5, 239.5, {}).value();
  return made;
}

/// Turned about the upright axis by so much; what is straight ahead at 0 then stands at f tan(angle).
vo::SE3 turned(double angle) {
  return vo::SE3(vo::so3_exp(vo::Vec3(0, angle, 0)), vo::Vec3(0.3, 0, 0));
}

vo::Vec2 moved(const detector::CameraMotion& motion, const vo::Vec2& px) {
  const auto& h = motion.far_homography;
  const double w = h[6] * px.x() + h[7] * px.y() + h[8];
  return vo::Vec2((h[0] * px.x() + h[1] * px.y() + h[2]) / w, (h[3] * px.x() + h[4] * px.y() + h[5]) / w);
}

bool still(const detector::CameraMotion& motion) {
  return motion.far_homography == detector::CameraMotion{}.far_homography;
}

TEST(CameraTurn, AFarPointIsWhereItWillBeSeen) {
  CameraTurn turn(camera());
  constexpr double kStep = 0.02;
  for (int i = 0; i < 3; ++i) {
    turn.next(i * kFrame);
    turn.note_tracked(i * kFrame, 1, turned(kStep * i));
  }
  const vo::Vec3 far(200, -150, 1000);
  vo::Vec2 before, after;
  ASSERT_TRUE(camera().project(turned(2 * kStep).R * far, &before));
  ASSERT_TRUE(camera().project(turned(3 * kStep).R * far, &after));
  EXPECT_GT((after - before).norm(), 8.0);
  const auto motion = turn.next(3 * kFrame);
  EXPECT_LT((moved(motion, before) - after).norm(), 0.01);
  // The next picture without a pose in between: another step of the same turn, not two.
  ASSERT_TRUE(camera().project(turned(4 * kStep).R * far, &before));
  EXPECT_LT((moved(turn.next(4 * kFrame), after) - before).norm(), 0.01);
}

TEST(CameraTurn, AMissingPictureIsTurnedThrough) {
  CameraTurn turn(camera());
  for (int i = 0; i < 2; ++i) {
    turn.next(i * kFrame);
    turn.note_tracked(i * kFrame, 1, turned(0.02 * i));
  }
  const vo::Vec3 far(0, 0, 1000);
  vo::Vec2 before, after;
  ASSERT_TRUE(camera().project(turned(0.02).R * far, &before));
  ASSERT_TRUE(camera().project(turned(0.06).R * far, &after));
  EXPECT_LT((moved(turn.next(3 * kFrame), before) - after).norm(), 0.01);
}

TEST(CameraTurn, WithoutTwoFreshPosesOfOneMapNothingTurns) {
  CameraTurn turn(camera());
  EXPECT_TRUE(still(turn.next(0)));
  turn.note_tracked(0, 1, turned(0));
  EXPECT_TRUE(still(turn.next(kFrame))) << "one pose";
  turn.note_tracked(kFrame, 2, turned(0.02));
  EXPECT_TRUE(still(turn.next(2 * kFrame))) << "of another map";
  turn.note_tracked(2 * kFrame, 2, turned(0.04));
  EXPECT_FALSE(still(turn.next(3 * kFrame)));
  EXPECT_TRUE(still(turn.next(2 * kFrame + CameraTurn::kStaleNs + 1))) << "of long ago";
  turn.note_tracked(20 * kFrame, 2, turned(0.06));
  EXPECT_TRUE(still(turn.next(21 * kFrame))) << "too long between the two";
}

}  // namespace camera_turn_test
}  // namespace godwit::app
