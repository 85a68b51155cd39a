// The mapper by itself, told the truth about the camera, or not quite.
#include "vo_core/map/mapper.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <gtest/gtest.h>
#include <memory>
#include <random>
#include <vector>

#include "tests/vo_core/synthetic_scene.h"

namespace godwit::vo {
namespace mapper_test {

class MapperTest : public testing::Test {
 protected:
  static const CameraModel& camera() {
    static const CameraModel some =
        CameraModel::pinhole_radtan(320, 240, 260, 260, 160, 120, {0.05, -0.02, 0, 0, 0}).value();
    return some;
  }
  static SE3 pose_of(int i) { return SE3(Mat3::Identity(), Vec3(-0.04 * i, 0.01 * i, 0.0)); }

  void SetUp() override {
    MapperMessage* m = channel_->messages.claim();
    m->kind = MessageKind::kReset;
    m->epoch = 1;
    m->slot = -1;
    handle();
    for (int y = 20; y < 230; y += 20)
      for (int x = 20; x < 310; x += 20) {
        const Vec3 bearing = camera().unproject(Vec2(x, y));
        points_.push_back(bearing / bearing.z() * scene_.depth(camera(), pose_of(0), Vec2(x, y)));
      }
  }

  /// Sends what is claimed and lets the mapper handle it; the answer is kept.
  void handle() {
    channel_->messages.commit();
    while (mapper_.step()) {
    }
    answer_.clear();
    while (const MapDelta* d = channel_->deltas.front()) {
      answer_ = *d;
      channel_->deltas.pop();
    }
    SlotRelease release;
    while (mapper_.take_release(&release)) {
    }
  }

  /// A message from a frame at T, seen in a picture with some noise.
  MapperMessage* frame(MessageKind kind, const SE3& T) {
    pictures_.push_back(std::make_unique<test::Picture>(scene_.render(camera(), T)));
    pictures_.back()->add_noise(1.5, static_cast<unsigned>(pictures_.size()));
    pyramids_.push_back(std::make_unique<test::Pyramid>(pictures_.back()->view()));
    MapperMessage* m = channel_->messages.claim();
    m->kind = kind;
    m->epoch = 1;
    m->sequence = static_cast<std::uint32_t>(pictures_.size());
    m->slot = static_cast<int>(pictures_.size());
    m->pyramid = pyramids_.back()->view();
    m->t_capture_ns = static_cast<rt::TimeNs>(pictures_.size()) * 33'333'333;
    m->anchor_id = 0;
    m->T_cam_anchor = T;
    m->motion.velocity.setZero();
    m->tracked_features = 150;
    m->median_depth = 3.0;
    m->min_depth = 1.0;
    m->mask.assign(rt::MaskPyramidView{});
    m->initial = false;
    m->feature_count = m->weak_count = 0;
    return m;
  }

  /// Keyframe `id` at T, in which the known points are measured with noise.
  void keyframe(int id, const SE3& T, double noise_px, const std::function<void(MapperMessage*)>& change = {}) {
    MapperMessage* m = frame(MessageKind::kKeyframe, T);
    m->keyframe_id = static_cast<std::uint32_t>(id);
    m->keyframe_place = id - 1;
    m->initial = id < 3;
    std::mt19937 random(static_cast<unsigned>(id));
    std::normal_distribution<double> noise(0.0, noise_px);
    for (std::size_t i = 0; i < points_.size(); ++i) {
      Vec2 px;
      if (!camera().project(T * points_[i], &px) || !camera().in_image(px, 8.0)) continue;
      const auto k = static_cast<std::size_t>(m->feature_count++);
      m->features[k] = {};
      m->features[k].px = m->features[k].px_global = (px + Vec2(noise(random), noise(random))).cast<float>();
      m->features[k].point = {static_cast<std::uint16_t>(i), 0};
      m->initial_points[k] = points_[i].cast<float>();
    }
    if (change) change(m);
    handle();
  }

  const test::SyntheticScene scene_ = test::SyntheticScene::general();
  std::vector<Vec3> points_;
  std::vector<std::unique_ptr<test::Picture>> pictures_;
  std::vector<std::unique_ptr<test::Pyramid>> pyramids_;
  std::unique_ptr<MapChannel> channel_ = std::make_unique<MapChannel>();
  MapDelta answer_;
  MapperOptions options_;
  Mapper mapper_{camera(), options_, channel_.get()};
};

class MapperWithHardlyAnyRoom : public MapperTest {
 protected:
  MapperWithHardlyAnyRoom() { options_.spare_points = kMaxPoints - 100; }
  void SetUp() override {
    std::destroy_at(&mapper_);
    std::construct_at(&mapper_, camera(), options_, channel_.get());
    MapperTest::SetUp();
  }
};

// A map that is full takes in no new points, and what flies on sees less and less of it: every flight longer than that
// ended there.
TEST_F(MapperWithHardlyAnyRoom, TheFarthestKeyframesGoBeforeTheMapIsFull) {
  for (int id = 1; id <= 7; ++id) keyframe(id, pose_of(2 * id), 0.3);
  EXPECT_EQ(answer_.removed_keyframe_count, 0) << "the first two and the newest stay";
  keyframe(8, pose_of(16), 0.3);
  ASSERT_EQ(answer_.removed_keyframe_count, 1);
  EXPECT_EQ(answer_.removed_keyframes[0], 3u);
  EXPECT_EQ(mapper_.map().keyframe_count(), 7);
  keyframe(9, pose_of(18), 0.3);
  ASSERT_EQ(answer_.removed_keyframe_count, 1);
  EXPECT_EQ(answer_.removed_keyframes[0], 4u);
}

TEST_F(MapperTest, AKeyframeHangsOnItsAnchorWhereverThatHasMoved) {
  keyframe(1, pose_of(0), 0.7);
  keyframe(2, pose_of(2), 0.7);
  keyframe(3, pose_of(4), 0.7);
  const SE3 anchor = mapper_.map().keyframe(2).T_kf_world;
  ASSERT_GT((anchor.t - pose_of(4).t).norm(), 1e-4) << "the adjustment has moved it";
  const SE3 T_4_3 = pose_of(6) * pose_of(4).inverse();
  keyframe(4, pose_of(6), 0.7, [&](MapperMessage* m) {
    m->anchor_id = 3;
    m->T_cam_anchor = T_4_3;
    m->feature_count = 0;  // so that nothing but the message says where it is
  });
  const SE3 expected = T_4_3 * anchor;
  EXPECT_LT((mapper_.map().keyframe(3).T_kf_world.t - expected.t).norm(), 1e-12);
  // And the tracker, which placed it by an older map, is told.
  ASSERT_EQ(answer_.moved_keyframe_count, 1);
  EXPECT_EQ(answer_.moved_keyframes[0].keyframe_id, 4u);
  EXPECT_LT((answer_.moved_keyframes[0].T_kf_world.t - expected.t).norm(), 1e-12);
}

// A camera that stands still, or turns on the spot, learns nothing about depth; nor does it learn that the seeds are
// bad.
TEST_F(MapperTest, HoveringAndTurningOnTheSpotCostNoSeeds) {
  for (const bool turning : {false, true}) {
    if (turning) {
      MapperMessage* m = channel_->messages.claim();
      m->kind = MessageKind::kReset;
      m->epoch = 1;
      m->slot = -1;
      handle();
    }
    keyframe(1, pose_of(0), 0.0);
    keyframe(2, pose_of(1), 0.0);
    int first = 0, points_at_first = 0;
    for (int i = 0; i < 45; ++i) {
      const Vec3 turn(0.0, turning ? 0.1 * std::sin(0.2 * i) : 0.0, 0.0);
      frame(MessageKind::kFrame, SE3(so3_exp(turn), Vec3::Zero()) * pose_of(1));
      handle();
      if (i == 0) first = mapper_.report().seeds;
      if (i == 0) points_at_first = mapper_.report().points;
    }
    EXPECT_GT(first, 60);
    // Those that have become points meanwhile are no loss.
    EXPECT_GE(mapper_.report().seeds + mapper_.report().points - points_at_first, first * 8 / 10)
        << (turning ? "turning" : "hovering");
  }
}

}  // namespace mapper_test
}  // namespace godwit::vo
