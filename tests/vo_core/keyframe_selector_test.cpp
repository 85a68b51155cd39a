// When a frame becomes a keyframe.
#include "vo_core/keyframe_selector.h"

#include <gtest/gtest.h>

namespace godwit::vo {
namespace {

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
  f.nearest_angle_rad = 0.27;
  EXPECT_EQ(select(f), KeyframeReason::kTurned);
  f = quiet();
  f.features = 100;
  EXPECT_EQ(select(f), KeyframeReason::kFeaturesDropped);
  f.last_distance = f.nearest_distance = 0.0;
  EXPECT_EQ(select(f), KeyframeReason::kNone) << "without motion it would see no more";
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

}  // namespace
}  // namespace godwit::vo
