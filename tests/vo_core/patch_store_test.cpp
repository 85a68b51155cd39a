#include "vo_core/tracking/patch_store.h"

#include <gtest/gtest.h>
#include <memory>
#include <vector>

#include "tests/vo_core/synthetic_scene.h"
#include "vo_core/image/pyramid.h"

namespace godwit::vo {
namespace patch_store_test {

// A keyframe before a plane, one feature in its middle, and where the camera turns about its axis afterwards.
struct World {
  CameraModel camera = CameraModel::pinhole_radtan(320, 240, 260, 260, 160, 120, {0, 0, 0, 0, 0}).value();
  test::SyntheticScene scene = test::SyntheticScene::plane();
  test::Picture picture = scene.render(camera, SE3());
  std::vector<std::uint8_t> storage = std::vector<std::uint8_t>(pyramid_bytes(320, 240, 4) + 256);
  std::unique_ptr<Map> map = std::make_unique<Map>();
  PointHandle point;
  double depth = 0.0;

  World() {
    KeyframeView view;
    view.pyramid = build_pyramid(picture.view(), 4, test::aligned(&storage), storage.size() - rt::kRowAlignment);
    map->insert_keyframe(0, 1, view);
    point = map->free_point();
    KeyframeFeature f;
    f.px = f.px_global = Vec2f(150, 110);
    f.bearing = camera.unproject(Vec2(150, 110));
    f.point = point;
    depth = scene.depth(camera, SE3(), Vec2(150, 110)) / f.bearing.z();
    map->activate_point(point, f.bearing * depth);
    map->append_feature(0, f);
  }
  const PreparedPatch* prepared(PatchStore* store, double turned_rad) const {
    return store->prepared(camera, map->keyframe(0), 0, point, depth,
                           SE3(so3_exp(Vec3(0, 0, turned_rad)), Vec3::Zero()), 3);
  }
};

TEST(PatchStore, CutsAnewOnlyWhatHasTurned) {
  const World w;
  PatchStore store, fresh;
  const PreparedPatch* p = w.prepared(&store, 0.0);
  ASSERT_NE(p, nullptr);
  EXPECT_NEAR(p->A_cur_ref(0, 1), 0.0f, 1e-5f);
  const Eigen::Matrix2f first = p->A_cur_ref;
  // 0.01 rad move the rim by 0.04 px; 0.2 rad by 0.8 px.
  p = w.prepared(&store, 0.01);
  ASSERT_NE(p, nullptr);
  EXPECT_EQ(p->A_cur_ref, first);
  p = w.prepared(&store, 0.2);
  const PreparedPatch* const anew = w.prepared(&fresh, 0.2);
  ASSERT_NE(p, nullptr);
  ASSERT_NE(anew, nullptr);
  EXPECT_EQ(p->A_cur_ref, anew->A_cur_ref);
  EXPECT_EQ(p->reference.value, anew->reference.value);
}

TEST(PatchStore, KnowsOnePointFromAnotherInItsPlace) {
  const World w;
  PatchStore store;
  ASSERT_NE(w.prepared(&store, 0.0), nullptr);
  // The place of a point that was deleted is used again.
  w.map->remove_point(w.point);
  const PointHandle next{w.point.index, static_cast<std::uint16_t>(w.point.generation + 1)};
  w.map->activate_point(next, w.map->keyframe(0).features[0].bearing * w.depth);
  KeyframeFeature f = w.map->keyframe(0).features[0];
  f.px = f.px_global = Vec2f(200, 150);
  f.bearing = w.camera.unproject(Vec2(200, 150));
  f.point = next;
  const int feature = w.map->append_feature(0, f);
  PatchStore fresh;
  const PreparedPatch* p = store.prepared(w.camera, w.map->keyframe(0), feature, next, w.depth, SE3(), 3);
  const PreparedPatch* q = fresh.prepared(w.camera, w.map->keyframe(0), feature, next, w.depth, SE3(), 3);
  ASSERT_NE(p, nullptr);
  ASSERT_NE(q, nullptr);
  EXPECT_EQ(p->reference.value, q->reference.value);
}

}  // namespace patch_store_test
}  // namespace godwit::vo
