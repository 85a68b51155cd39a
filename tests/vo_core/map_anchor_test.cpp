// What is told of vision's own error since the anchor.
#include "vo_core/inertial/map_anchor.h"

#include <gtest/gtest.h>

namespace godwit::vo {
namespace map_anchor_test {

// They tell of one walk: added, a map that grew well would be told as if it strayed twice.
TEST(MapAnchor, OfTheTrackersWordAndTheWalkTheLargerIsToldAlongEachAxis) {
  const double scale = 2, strayed2 = 1e-4;
  MapPose pose;
  pose.T_map_cam.R = so3_exp(Vec3(0.4, -0.2, 0.9));
  MapAnchor anchor;
  anchor.begin(pose, Vec3(0.1, -0.9, 0.2).normalized(), nullptr);
  const Mat3 axes = so3_exp(Vec3(0.3, 0.5, -0.1));  // of what the tracker says, along the camera's
  const Vec3 tracker(4e-4, 1e-6, 9e-5), own(1e-5, 2e-5, 3e-5);
  pose.covariance.topLeftCorner<3, 3>() = axes * tracker.asDiagonal() * axes.transpose();
  pose.covariance(4, 4) = 1e-6;
  pose.own_covariance.diagonal().head<3>() = own;
  const Mat3 R_nav_cam = anchor.R_nav_map() * pose.T_map_cam.R;
  const auto told = [&](const Vec3& variances) {
    const Mat3 cam = axes * variances.asDiagonal() * axes.transpose() + Mat3(own.asDiagonal());
    return Mat3(scale * scale * R_nav_cam * cam * R_nav_cam.transpose());
  };
  const Mat6 alone = anchor.grown(pose, scale), both = anchor.grown(pose, scale, strayed2);
  EXPECT_LT((alone.topLeftCorner<3, 3>() - told(tracker)).norm(), 1e-12);
  EXPECT_LT((both.topLeftCorner<3, 3>() - told(tracker.cwiseMax(strayed2))).norm(), 1e-12);
  EXPECT_EQ(Mat3(both.bottomRightCorner<3, 3>()), Mat3(alone.bottomRightCorner<3, 3>()));
}

}  // namespace map_anchor_test
}  // namespace godwit::vo
