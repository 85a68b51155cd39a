#include "vo_core/map/map.h"

#include <gtest/gtest.h>

#include "vo_core/map/keyframe_selector.h"
#include "vo_core/map/map_channel.h"

namespace godwit::vo {
namespace map_test {

KeyframeFeature sees(PointHandle h) {
  KeyframeFeature f;
  f.point = h;
  return f;
}

TEST(Map, AStaleHandleFindsNothing) {
  Map map;
  const PointHandle h = map.free_point();
  map.activate_point(h, Vec3(1, 2, 3));
  ASSERT_NE(map.find(h), nullptr);
  map.remove_point(h);
  EXPECT_EQ(map.find(h), nullptr);
  map.remove_point(h);  // again: nothing happens
  EXPECT_EQ(map.point_count(), 0);
  const PointHandle again{h.index, map.point(h.index).generation};
  map.activate_point(again, Vec3::Zero());
  EXPECT_EQ(map.find(h), nullptr);
  EXPECT_NE(map.find(again), nullptr);
}

TEST(Map, APointDiesWithItsLastObservation) {
  Map map;
  map.insert_keyframe(0, 1);
  map.insert_keyframe(1, 2);
  const PointHandle h = map.free_point();
  map.activate_point(h, Vec3::UnitZ());
  EXPECT_EQ(map.append_feature(0, sees(h)), 0);
  EXPECT_EQ(map.append_feature(1, sees(h)), 0);
  map.remove_keyframe(0);
  ASSERT_NE(map.find(h), nullptr);
  EXPECT_EQ(map.find(h)->observation_count, 1);
  EXPECT_EQ(map.find(h)->observations[0].keyframe, 1);
  map.remove_observation(1, 0);
  EXPECT_EQ(map.find(h), nullptr);
  EXPECT_EQ(map.keyframe(1).feature_count, 1) << "a feature keeps its place, so that both replicas name it alike";
}

TEST(Map, RemovingAPointDetachesItsFeatures) {
  Map map;
  map.insert_keyframe(3, 1);
  const PointHandle h = map.free_point();
  map.activate_point(h, Vec3::UnitZ());
  map.append_feature(3, sees(h));
  map.remove_point(h);
  EXPECT_FALSE(map.keyframe(3).features[0].point.valid());
}

TEST(Map, FullKeyframesAndFullPointsAreRefusedNotOverrun) {
  Map map;
  map.insert_keyframe(0, 1);
  for (int i = 0; i < kMaxKeyframeFeatures; ++i) ASSERT_EQ(map.append_feature(0, KeyframeFeature{}), i);
  EXPECT_EQ(map.append_feature(0, KeyframeFeature{}), -1);
  for (int i = 0; i < kMaxPoints; ++i) {
    const PointHandle h = map.free_point();
    ASSERT_TRUE(h.valid());
    map.activate_point(h, Vec3::Zero());
  }
  EXPECT_FALSE(map.free_point().valid());
}

TEST(Map, ClearMakesAllHandlesStale) {
  Map map;
  const PointHandle h = map.free_point();
  map.activate_point(h, Vec3::Zero());
  map.insert_keyframe(0, 1);
  map.clear();
  EXPECT_EQ(map.find(h), nullptr);
  EXPECT_EQ(map.keyframe_count(), 0);
  EXPECT_EQ(map.find_keyframe(1), -1);
}

TEST(ExchangeRing, ItemsComeBackInOrderAndAreBounded) {
  ExchangeRing<int, 4> ring;
  for (int i = 0; i < 4; ++i) {
    int* item = ring.claim();
    ASSERT_NE(item, nullptr);
    EXPECT_EQ(ring.claim(), item) << "the same item until it is committed";
    *item = i;
    ring.commit();
  }
  EXPECT_EQ(ring.claim(), nullptr);
  for (int i = 0; i < 4; ++i) {
    ASSERT_NE(ring.front(), nullptr);
    EXPECT_EQ(*ring.front(), i);
    ring.pop();
  }
  EXPECT_EQ(ring.front(), nullptr);
  EXPECT_EQ(ring.free_items(), 4u);
}

TEST(KeyframeSelector, EachReasonHasItsLimit) {
  const KeyframeSelectorOptions o;
  KeyframeFigures f;
  f.frames_since_last = 10;
  f.features = f.last_keyframe_features = 150;
  EXPECT_EQ(select_keyframe(o, f), KeyframeReason::kNone);
  f.nearest_distance = 0.2;
  EXPECT_EQ(select_keyframe(o, f), KeyframeReason::kMoved);
  f.nearest_distance = KeyframeFigures::kNone;  // none looks the same way
  f.nearest_angle_rad = 0.5;
  EXPECT_EQ(select_keyframe(o, f), KeyframeReason::kTurned);
  f.nearest_distance = 0.01;
  f.nearest_angle_rad = 0.0;
  f.features = 60;
  EXPECT_EQ(select_keyframe(o, f), KeyframeReason::kNone) << "a camera that stands still gains nothing by a keyframe";
  f.last_angle_rad = 0.1;
  EXPECT_EQ(select_keyframe(o, f), KeyframeReason::kFeaturesDropped);
  f.frames_since_last = 1;
  EXPECT_EQ(select_keyframe(o, f), KeyframeReason::kNone);
}

}  // namespace map_test
}  // namespace godwit::vo
