// When a frame becomes a keyframe.
#include "vo_core/map/keyframe_selector.h"

#include <gtest/gtest.h>

namespace godwit::vo {
namespace keyframe_selector_test {

/// A frame near its keyframe that sees as much as it did.
KeyframeFigures quiet() {
  KeyframeFigures f;
  f.keyframes = 10;
  f.frames_since_last = 10;
  f.features = f.last_keyframe_features = 150;
  f.nearest_distance = f.last_distance = 0.02;
  return f;
}
KeyframeReason select(const KeyframeFigures& f) {
  return select_keyframe(KeyframeSelectorOptions{}, f);
}

TEST(KeyframeSelector, NothingNewNoKeyframe) {
  EXPECT_EQ(select(quiet()), KeyframeReason::kNone);
}

TEST(KeyframeSelector, MotionTurnAndLackOfFeaturesEachCallForOne) {
  KeyframeFigures f = quiet();
  f.nearest_distance = 0.11;
  EXPECT_EQ(select(f), KeyframeReason::kMoved);
  f = quiet();
  f.nearest_distance = KeyframeFigures::kNone;
  f.nearest_angle_rad = 0.27;
  EXPECT_EQ(select(f), KeyframeReason::kTurned);
  f = quiet();
  f.features = 100;
  EXPECT_EQ(select(f), KeyframeReason::kFeaturesDropped);
  f.last_distance = f.nearest_distance = 0.0;
  EXPECT_EQ(select(f), KeyframeReason::kNone) << "without motion it would see no more";
}

// The figures as the tracker takes them, so that each reason can come about.
TEST(KeyframeSelector, FromAMapMotionTurnAndRollAreEachTold) {
  Map map;
  for (int k = 0; k < 8; ++k) {
    Keyframe& kf = map.insert_keyframe(k, static_cast<std::uint32_t>(k + 1));
    kf.T_kf_world = SE3(Mat3::Identity(), Vec3(0.2 * k, 0, 0));
  }
  const KeyframeSelectorOptions o;
  const double limit = o.min_angle_rad;
  const auto reason = [&](const SE3& T_cam_world) {
    KeyframeFigures f = quiet();
    compare_with_keyframes(o, map, T_cam_world, 1.0, 8, &f);
    EXPECT_EQ(f.keyframes, 8);
    return select_keyframe(o, f);
  };
  const auto turned = [](double angle, const Vec3& axis) {
    return SE3(so3_exp(angle * axis), Vec3::Zero()) * SE3(Mat3::Identity(), Vec3(0.62, 0, 0));
  };
  EXPECT_EQ(reason(turned(0.0, Vec3::UnitX())), KeyframeReason::kNone);
  EXPECT_EQ(reason(SE3(Mat3::Identity(), Vec3(0.62, 0.15, 0))), KeyframeReason::kMoved);
  for (const Vec3& axis : {Vec3(Vec3::UnitX()), Vec3(Vec3::UnitY()), Vec3(Vec3::UnitZ())}) {
    EXPECT_EQ(reason(turned(0.95 * limit, axis)), KeyframeReason::kNone) << axis.transpose();
    EXPECT_EQ(reason(turned(1.05 * limit, axis)), KeyframeReason::kTurned) << axis.transpose();
  }
  EXPECT_EQ(reason(SE3(so3_exp(Vec3(0, 1.1 * limit, 0)), Vec3(9, 0, 0))), KeyframeReason::kMoved);
  KeyframeFigures f;
  compare_with_keyframes(o, map, SE3(so3_exp(Vec3(0, 0.1, 0)), Vec3::Zero()), 2.0, 2, &f);
  EXPECT_NEAR(f.last_distance, 0.1, 1e-9);
  EXPECT_NEAR(f.last_angle_rad, 0.1, 1e-9);
}

TEST(KeyframeSelector, AYoungMapAsksEarlier) {
  KeyframeFigures f = quiet();
  f.nearest_distance = 0.06;
  EXPECT_EQ(select(f), KeyframeReason::kNone);
  f.keyframes = 5;
  EXPECT_EQ(select(f), KeyframeReason::kMoved);
}

TEST(KeyframeSelector, WhatMoversLayBareCallsForOne) {
  KeyframeFigures f = quiet();
  f.uncovered = 0.07;
  EXPECT_EQ(select(f), KeyframeReason::kNone);
  f.uncovered = 0.09;
  EXPECT_EQ(select(f), KeyframeReason::kUncovered);
  f.frames_since_last = 1;
  EXPECT_EQ(select(f), KeyframeReason::kNone) << "not two in a row";
}

}  // namespace keyframe_selector_test
}  // namespace godwit::vo
