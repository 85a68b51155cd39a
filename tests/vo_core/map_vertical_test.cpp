// Which way is up in vision's map by an autopilot's attitude, where vision strays and bundle adjustment takes that
// back.
#include "vo_core/inertial/map_vertical.h"

#include <cmath>
#include <gtest/gtest.h>

namespace godwit::vo {
namespace map_vertical_test {

constexpr double kStrayed = 2e-3;  // in so long, and then it is corrected [rad]
constexpr rt::TimeNs kPictureNs = 50 * rt::kNsPerMs;

/// 20 pictures and 20 attitudes a second for a while; each kStrayedNs a correction takes back what vision had strayed
/// by. How far the vertical is off at the end [rad].
double off_after(double seconds) {
  const Vec3 up = Vec3(0.2, -0.9, 0.3).normalized(), axis = up.cross(Vec3::UnitX()).normalized();
  MapVertical vertical(Mat3::Identity());
  const rt::TimeNs begin_ns = rt::kNsPerSecond;
  rt::TimeNs since_ns = begin_ns;
  for (rt::TimeNs t_ns = begin_ns; t_ns < begin_ns + static_cast<rt::TimeNs>(seconds * 1e9); t_ns += kPictureNs) {
    if (t_ns - since_ns > kStrayedNs) {
      const rt::TimeNs last_ns = t_ns - kPictureNs;
      const double strayed = kStrayed * rt::to_seconds(last_ns - since_ns) / rt::to_seconds(kStrayedNs);
      vertical.correct_map({last_ns - kStrayedNs, last_ns, Vec3::Zero(), -strayed * axis, Vec3::Zero()});
      since_ns = last_ns;
    }
    const double strayed = kStrayed * rt::to_seconds(t_ns - since_ns) / rt::to_seconds(kStrayedNs);
    vertical.take({t_ns, up, 0.02});
    vertical.pose(t_ns, 1, so3_exp(strayed * axis), 1e-8);
  }
  EXPECT_TRUE(vertical.known());
  return angle_between(vertical.up(), up);
}

// Moved by all of each correction the mean of a minute leant further with every one: what vision had seen before it
// strayed was right.
TEST(MapVertical, ACorrectionMovesOnlyWhatWasSeenWhileVisionStrayed) {
  EXPECT_LT(off_after(0.9), kStrayed);
  EXPECT_LT(off_after(60), kStrayed);
}

// A map that turns as a whole takes all it knows along.
TEST(MapVertical, AMapThatTurnsAsAWholeTakesTheVerticalAlong) {
  const Vec3 up = Vec3::UnitZ(), turn(0.03, -0.02, 0.01);
  MapVertical vertical(Mat3::Identity());
  for (int k = 0; k < 100; ++k) {
    vertical.take({(k + 1) * kPictureNs, up, 0.02});
    vertical.pose((k + 1) * kPictureNs, 1, Mat3::Identity(), 1e-8);
  }
  vertical.correct_map({0, 0, Vec3::Zero(), turn, Vec3::Zero()});
  EXPECT_LT(angle_between(vertical.up(), so3_exp(turn) * up), 1e-6);
}

}  // namespace map_vertical_test
}  // namespace godwit::vo
