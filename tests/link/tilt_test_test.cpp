#include "firmware_app/link/tilt_test.h"

#include <gtest/gtest.h>

namespace godwit::link {
namespace tilt_test_test {

Eigen::Vector4d quaternion(const Eigen::Matrix3d& R) {
  const Eigen::Quaterniond q(R);
  return {q.w(), q.x(), q.y(), q.z()};
}

Eigen::Matrix3d turn(double degrees, const Eigen::Vector3d& axis) {
  return Eigen::AngleAxisd(degrees * M_PI / 180, axis).toRotationMatrix();
}

// The test as a user does it, with a camera whose mounting is wrong by S: our body axes are S^T of the true ones.
std::vector<std::string> tilt_result(const Eigen::Matrix3d& S, double scale = 1) {
  TiltTest test;
  const Eigen::Matrix3d heading = turn(40, Eigen::Vector3d::UnitZ()), other = turn(-75, Eigen::Vector3d::UnitZ());
  for (const auto& [degrees, axis] : {std::pair{0.0, Eigen::Vector3d(0, 1, 0)}, {30.0, {0, 1, 0}}, {25.0, {1, 0, 0}}}) {
    const auto held =
        test.hold(quaternion(heading * turn(degrees, axis)), quaternion(other * turn(degrees * scale, axis) * S));
    EXPECT_TRUE(held.ok()) << held.error().message;
  }
  EXPECT_EQ(test.step(), TiltTest::Step::kDone);
  return test.result();
}

TEST(TiltTest, RightMountingIsFoundRight) {
  EXPECT_TRUE(tilt_result(Eigen::Matrix3d::Identity()).empty());
}

TEST(TiltTest, WrongAxesAreNamed) {
  const auto yawed = tilt_result(turn(90, Eigen::Vector3d::UnitZ()));
  ASSERT_EQ(yawed.size(), 1U);
  EXPECT_NE(yawed[0].find("front is right"), std::string::npos) << yawed[0];
  EXPECT_NE(yawed[0].find("right is back"), std::string::npos) << yawed[0];
  const auto upside_down = tilt_result(turn(180, Eigen::Vector3d::UnitX()));
  ASSERT_EQ(upside_down.size(), 1U);
  EXPECT_NE(upside_down[0].find("down is up"), std::string::npos) << upside_down[0];
}

TEST(TiltTest, SmallMountingErrorsAreMeasured) {
  const auto pitched = tilt_result(turn(8, Eigen::Vector3d::UnitY()));
  ASSERT_EQ(pitched.size(), 1U);
  EXPECT_NE(pitched[0].find("pitch"), std::string::npos);
  EXPECT_NE(pitched[0].find(" 8 degrees"), std::string::npos) << pitched[0];
}

TEST(TiltTest, AWrongMovementAndABlindCameraAreTold) {
  TiltTest test;
  const Eigen::Vector4d level(1, 0, 0, 0);
  EXPECT_FALSE(test.hold(quaternion(turn(20, Eigen::Vector3d::UnitX())), level).ok());
  EXPECT_TRUE(test.hold(level, level).ok());
  const auto wrong = test.hold(quaternion(turn(30, Eigen::Vector3d::UnitX())), level);
  ASSERT_FALSE(wrong.ok());
  EXPECT_NE(wrong.error().message.find("nose"), std::string::npos);
  EXPECT_EQ(test.step(), TiltTest::Step::kNoseUp);
  const auto blind = tilt_result(Eigen::Matrix3d::Identity(), 0.05);
  ASSERT_FALSE(blind.empty());
  EXPECT_NE(blind[0].find("hardly saw"), std::string::npos);
}

}  // namespace tilt_test_test
}  // namespace godwit::link
