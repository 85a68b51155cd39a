// Finding the pose of a frame by what map points look like.
#include "vo_core/tracking/landmark_finder.h"

#include <gtest/gtest.h>
#include <vector>

#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"
#include "tests/vo_core/synthetic_picture.h"
#include "tests/vo_core/synthetic_scene.h"

namespace godwit::vo {
namespace landmark_finder_test {

CameraModel camera() {
  return CameraModel::pinhole_radtan(640, 480, 520, 520, 320, 240, {}).value();
}

SE3 pose(const Vec3& position, const Vec3& turn) {
  const Mat3 R = so3_exp(turn);
  return {R, -(R * position)};
}

/// A rendered picture with its pyramid.
struct View {
  explicit View(const SE3& T, const test::SyntheticScene& scene = test::SyntheticScene::general(), double gain = 1.0)
      : picture(scene.render(camera(), T, gain)), pyramid(picture.view()) {}
  test::Picture picture;
  test::Pyramid pyramid;
};

TEST(Brief, ATurnedPatchHasTheSameDescriptorUnderTheTurnedPattern) {
  const View upright{SE3()}, turned{pose(Vec3::Zero(), Vec3(0, 0, 1.0))};
  // The picture's centre stays where it is.
  const Vec2f centre(320, 240);
  BriefDescriptor a, b, other;
  ASSERT_TRUE(BriefPattern(0.0).describe(upright.pyramid.view(), centre, &a));
  ASSERT_TRUE(BriefPattern(1.0).describe(turned.pyramid.view(), centre, &b));
  ASSERT_TRUE(BriefPattern(0.0).describe(turned.pyramid.view(), centre, &other));
  EXPECT_EQ(a.distance(a), 0);
  EXPECT_LT(a.distance(b), 80);
  EXPECT_GT(a.distance(other), 100);
}

TEST(Brief, APatchThatLeavesThePictureHasNone) {
  const View v{SE3()};
  BriefDescriptor d;
  EXPECT_FALSE(BriefPattern(0.0).describe(v.pyramid.view(), Vec2f(30, 240), &d));
  EXPECT_FALSE(BriefPattern(0.0).describe(v.pyramid.view(), Vec2f(320, 455), &d));
}

/// A map of one keyframe at the origin whose points have their true places.
class LandmarkFinderTest : public testing::Test {
 protected:
  void SetUp() override {
    Keyframe& kf = map_.insert_keyframe(0, 1);
    kf.pyramid = keyframe_.pyramid.view();
    kf.median_depth = 3.0;
    FeatureDetector detector(camera_.width(), camera_.height(), FeatureDetectorOptions{.edgelets = false});
    std::vector<Feature> corners(300);
    const int n = detector.detect(kf.pyramid, {}, {}, 300, corners);
    ASSERT_GT(n, 150);
    for (int i = 0; i < n; ++i) {
      const Feature& c = corners[static_cast<std::size_t>(i)];
      const Vec2 px = c.px.cast<double>();
      const Vec3 bearing = camera_.unproject(px);
      KeyframeFeature f;
      f.px = f.px_global = c.px;
      f.bearing = bearing;
      f.level = c.level;
      f.point = map_.free_point();
      map_.activate_point(f.point, bearing / bearing.z() * scene_.depth(camera_, SE3(), px));
      map_.append_feature(0, f);
    }
  }

  const CameraModel camera_ = camera();
  const test::SyntheticScene scene_ = test::SyntheticScene::general();
  const View keyframe_{SE3()};
  Map map_;
  LandmarkFinder finder_{camera_, LandmarkFinderOptions{}};
};

TEST_F(LandmarkFinderTest, WhereTheCameraWasNotLongAgoBoundsWhatIsCompared) {
  const SE3 truth = pose(Vec3(0.1, -0.05, 0.05), Vec3(0.03, -0.04, 0.02));
  const View now{truth};
  const LandmarkReport everywhere = finder_.find(map_, now.pyramid.view(), {}, 0);
  const LastSeen there{SE3(), 0.1}, elsewhere{pose(Vec3::Zero(), Vec3(0.0, 0.4, 0.0)), 0.1};
  const LandmarkReport near = finder_.find(map_, now.pyramid.view(), {}, 0, &there);
  ASSERT_TRUE(near.found);
  EXPECT_LT((near.T_cam_world.inverse().t - truth.centre()).norm(), 0.03);
  EXPECT_GE(near.agreeing, everywhere.agreeing) << "fewer points that could be taken for the right one";
  EXPECT_FALSE(finder_.find(map_, now.pyramid.view(), {}, 0, &elsewhere).found);
  // After a while it may have turned that far.
  const LastSeen long_ago{elsewhere.T_cam_world, 3.0};
  EXPECT_TRUE(finder_.find(map_, now.pyramid.view(), {}, 0, &long_ago).found);
}

TEST_F(LandmarkFinderTest, ACameraFarFromTheKeyframeIsFound) {
  const SE3 truth = pose(Vec3(0.25, -0.1, 0.15), Vec3(0.1, -0.12, 0.1));
  const View now{truth};
  const LandmarkReport r = finder_.find(map_, now.pyramid.view(), {}, 0);
  ASSERT_TRUE(r.found) << r.matches << " matches, " << r.agreeing << " agree";
  EXPECT_LT((r.T_cam_world.inverse().t - truth.centre()).norm(), 0.03);
  EXPECT_LT(so3_log(r.T_cam_world.R * truth.R.transpose()).norm(), 0.01);
}

TEST_F(LandmarkFinderTest, HalfThePictureMayBeHidden) {
  const SE3 truth = pose(Vec3(0.15, 0.05, 0.05), Vec3(0.05, -0.08, 0.0));
  test::Picture picture = scene_.render(camera_, truth);
  const test::Picture other = test::rectangles(320, 480, 120, 7);
  for (int y = 0; y < 480; ++y)
    for (int x = 0; x < 320; ++x) picture(x, y) = other.view().at(x, y);
  const test::Pyramid pyramid(picture.view());
  test::Mask mask(camera_.width(), camera_.height());
  mask.add_rectangle(0, 0, 320, 480);
  const LandmarkReport r = finder_.find(map_, pyramid.view(), mask.view(), 0);
  ASSERT_TRUE(r.found) << r.matches << " matches, " << r.agreeing << " agree";
  EXPECT_LT((r.T_cam_world.inverse().t - truth.centre()).norm(), 0.03);
}

TEST_F(LandmarkFinderTest, ATurnAboutTheOpticalAxisIsFoundByTheTurnedAttempts) {
  const SE3 truth = pose(Vec3(0.05, 0.0, 0.0), Vec3(0, 0, 1.5));
  const View now{truth};
  bool found = false;
  for (int attempt = 0; attempt < 36 && !found; ++attempt) {
    const LandmarkReport r = finder_.find(map_, now.pyramid.view(), {}, attempt);
    found = r.found && (r.T_cam_world.inverse().t - truth.centre()).norm() < 0.03;
  }
  EXPECT_TRUE(found);
}

TEST_F(LandmarkFinderTest, AnotherPlaceIsNotFound) {
  test::SyntheticScene other = scene_;
  for (test::Board& b : other.boards) b.seed += 1000;
  for (int i = 0; i < 6; ++i) {
    const View now{pose(Vec3(0.05 * i, 0, 0), Vec3::Zero()), other};
    EXPECT_FALSE(finder_.find(map_, now.pyramid.view(), {}, i).found);
  }
}

TEST_F(LandmarkFinderTest, AnEmptyMapABlackPictureAndAForgottenMapGiveNothing) {
  Map empty;
  EXPECT_FALSE(finder_.find(empty, keyframe_.pyramid.view(), {}, 0).found);
  const View black{SE3(), scene_, 0.0};
  EXPECT_FALSE(finder_.find(map_, black.pyramid.view(), {}, 0).found);
  ASSERT_TRUE(finder_.find(map_, keyframe_.pyramid.view(), {}, 0).found);
}

TEST_F(LandmarkFinderTest, WhatWasKnownOfAPointDoesNotCountForTheNextInItsPlace) {
  ASSERT_GT(finder_.find(map_, keyframe_.pyramid.view(), {}, 0).matches, 100);
  // The same handles come back, as they do from a mapper that begins anew; no keyframe shows them.
  std::vector<PointHandle> handles;
  handles.reserve(static_cast<std::size_t>(map_.point_end()));
  for (int i = 0; i < map_.point_end(); ++i)
    handles.push_back({static_cast<std::uint16_t>(i), map_.point(i).generation});
  map_.clear();
  for (const PointHandle& h : handles) map_.activate_point(h, Vec3(0, 0, 3));
  Keyframe& other = map_.insert_keyframe(0, 1);
  other.median_depth = 3.0;
  EXPECT_GT(finder_.find(map_, keyframe_.pyramid.view(), {}, 0).matches, 0) << "or forget() is not needed";
  finder_.forget();
  EXPECT_EQ(finder_.find(map_, keyframe_.pyramid.view(), {}, 0).matches, 0);
}

TEST_F(LandmarkFinderTest, NothingIsAllocated) {
  const View now{pose(Vec3(0.1, 0.0, 0.05), Vec3(0.02, -0.05, 0.0))};
  const rt::HeapCounts before = rt::rt_heap_counts();
  bool found = false;
  {
    const rt::RtScope scope;
    for (int attempt = 0; attempt < 3; ++attempt) {  // the third is turned
      found |= finder_.find(map_, now.pyramid.view(), {}, attempt).found;
      finder_.learn(map_, 50);
    }
  }
  EXPECT_EQ(rt::rt_heap_counts().allocations, before.allocations);
  EXPECT_TRUE(found);
}

}  // namespace landmark_finder_test
}  // namespace godwit::vo
