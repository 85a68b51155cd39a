// Tracker and mapper together on rendered pictures with exact truth.
#include <cstring>
#include <gtest/gtest.h>
#include <memory>
#include <vector>

#include "tests/vo_core/odometry_flight.h"

namespace godwit::vo {
namespace odometry_test {

using test::Flown;
using test::forward;
using test::kLamps;
using test::pictures;
using test::run_odometry;
using test::small_camera;
using test::sweep;
using test::SyntheticScene;

TEST(Odometry, FollowsARenderedFlight) {
  const Flown run = run_odometry(forward(60));
  const std::vector<SE3> truth = sweep(60);
  std::size_t first = 0;
  while (first < run.frames.size() && !run.frames[first].tracked) ++first;
  ASSERT_LT(first, 20u) << "no first map";
  // Also the very first pose says how sure it is.
  EXPECT_GT(run.frames[first].covariance.diagonal().minCoeff(), 0.0);
  int tracked = 0;
  for (std::size_t i = first; i < run.frames.size(); ++i) tracked += run.frames[i].tracked;
  EXPECT_EQ(tracked, static_cast<int>(run.frames.size() - first));
  // World: the first view's camera, in an unknown scale: least squares over the path.
  double num = 0, den = 0;
  for (std::size_t i = first; i < run.frames.size(); ++i) {
    const Vec3 t = truth[0] * truth[i].inverse().t;
    num += t.dot(run.frames[i].T_world_cam.t);
    den += run.frames[i].T_world_cam.t.squaredNorm();
  }
  const double scale = num / den;
  double worst = 0, worst_angle = 0;
  for (std::size_t i = first; i < run.frames.size(); ++i) {
    const Vec3 t = truth[0] * truth[i].inverse().t;
    worst = std::max(worst, (scale * run.frames[i].T_world_cam.t - t).norm());
    const Mat3 dR = run.frames[i].T_world_cam.R.transpose() * truth[0].R * truth[i].R.transpose();
    worst_angle = std::max(worst_angle, so3_log(dR).norm());
  }
  EXPECT_LT(worst, 0.02) << "of a path of 1.2 units";
  EXPECT_LT(worst_angle, 0.01);
}

TEST(Odometry, TwoRunsAreEqualToTheBitAndAPrefixIsAPrefix) {
  const Flown a = run_odometry(forward(60)), b = run_odometry(forward(60)), c = run_odometry(forward(40));
  for (std::size_t i = 0; i < 60; ++i) {
    EXPECT_EQ(a.frames[i].tracked, b.frames[i].tracked);
    EXPECT_EQ(a.frames[i].T_world_cam.t, b.frames[i].T_world_cam.t) << i;
    EXPECT_EQ(a.frames[i].T_world_cam.R, b.frames[i].T_world_cam.R) << i;
    if (i < 40) {
      EXPECT_EQ(a.frames[i].T_world_cam.t, c.frames[i].T_world_cam.t) << i;
    }
  }
}

TEST(Odometry, NothingIsAllocatedAfterTheFirstPose) {
  const Flown run = run_odometry(forward(60));
  EXPECT_EQ(run.allocations, 0u);
}

TEST(Odometry, FrameSlotsComeBack) {
  const Flown run = run_odometry(forward(60));
  EXPECT_LT(run.slots_out, 40) << "keyframes and the last frame may keep theirs";
}

// Neighbouring pictures cannot be laid on each other there: points are found from where the motion goes on as it was.
TEST(Odometry, LampsOnTheMainsAreTrackedThrough) {
  std::vector<int> order;
  for (int i = 0; i < 60; ++i) order.push_back(i < 24 ? i : kLamps + i);
  const Flown run = run_odometry(order);
  int tracked = 0;
  for (std::size_t i = 24; i < 60; ++i) tracked += run.frames[i].tracked;
  EXPECT_GE(tracked, 34);
  EXPECT_EQ(run.frames.back().map_id, run.frames[23].map_id);
}

TEST(Odometry, AFrozenPictureGivesNoPoseAndTheNextOneDoes) {
  std::vector<int> order = forward(40);
  for (int i = 0; i < 20; ++i) order.push_back(39);
  order.push_back(40);
  order.push_back(41);
  const Flown run = run_odometry(order), moving = run_odometry(forward(42));
  ASSERT_TRUE(run.frames[39].tracked);
  for (std::size_t i = 40; i < 60; ++i) {
    EXPECT_FALSE(run.frames[i].tracked) << i;
    EXPECT_TRUE(run.frames[i].repeated) << i;
    EXPECT_STREQ(run.frames[i].reason, "the picture is the one before, bit for bit");
    // Four repeated pictures are 133 ms.
    EXPECT_EQ(run.frames[i].state, i < 44 ? State::kTracking : State::kRelocalising) << i;
  }
  // 0.7 s later: near enough to be found, long enough ago to need a second look.
  EXPECT_FALSE(run.frames[60].tracked);
  ASSERT_TRUE(run.frames[61].tracked) << run.frames[61].reason;
  EXPECT_EQ(run.frames[61].map_id, run.frames[39].map_id);
  EXPECT_LT((run.frames[61].T_world_cam.t - moving.frames[41].T_world_cam.t).norm(), 0.01);
}

TEST(Odometry, APictureShownTwiceIsCountedAndCostsNothing) {
  std::vector<int> order = forward(40);
  order.push_back(39);
  order.push_back(40);
  const Flown run = run_odometry(order);
  ASSERT_TRUE(run.frames[39].tracked);
  EXPECT_TRUE(run.frames[40].repeated);
  EXPECT_FALSE(run.frames[40].tracked);
  EXPECT_EQ(run.frames[40].state, State::kTracking);
  EXPECT_TRUE(run.frames[41].tracked) << "the next new one is followed at once";
  EXPECT_FALSE(run.frames[41].repeated);
}

rt::MaskPyramidView mask_over_everything() {
  static const std::vector<std::uint8_t> ones(320 * 240, 255);
  rt::MaskPyramidView mask;
  mask.levels = rt::kPyramidLevels;
  for (int l = 0; l < mask.levels; ++l)
    mask.level[static_cast<std::size_t>(l)] = {ones.data(), 320 >> l, 240 >> l, 320};
  return mask;
}

TEST(Odometry, AMaskOverEverythingMeansNoMap) {
  const Flown masked = run_odometry(forward(30), mask_over_everything()), free = run_odometry(forward(30));
  for (std::size_t i = 0; i < masked.frames.size(); ++i) {
    const FrameResult& r = masked.frames[i];
    EXPECT_FALSE(r.tracked) << i;
    EXPECT_FALSE(r.is_keyframe) << i;
    EXPECT_EQ(r.state, State::kInitialising) << i;
    EXPECT_EQ(r.map_id, 0u) << i;
    EXPECT_EQ(r.init.tracks, 0) << i << ": nothing of it is followed";
    EXPECT_STREQ(r.reason, "too few features in the first view") << i;
  }
  EXPECT_TRUE(free.frames.back().tracked) << "it is the mask that makes the difference";
}

TEST(Odometry, AMaskOverEverythingLeavesTheProvedPointsAndSaysSo) {
  constexpr std::size_t kMasked = 40;
  const Flown run = run_odometry(forward(55), mask_over_everything(), kMasked);
  const Flown free = run_odometry(forward(55));
  ASSERT_TRUE(run.frames[kMasked - 1].tracked);
  int tracked = 0;
  for (std::size_t i = kMasked; i < run.frames.size(); ++i) {
    const FrameResult& r = run.frames[i];
    // Two frames later the mapper's last answer to a free picture has come.
    if (i > kMasked + 2) {
      EXPECT_LE(run.points[i], run.points[i - 1]) << i << ": nothing of it enters the map";
    }
    if (!r.tracked) continue;
    ++tracked;
    EXPECT_STREQ(r.reason, "tracking, mostly by proved points inside the mask");
    EXPECT_EQ(r.shaded, r.matches);
    EXPECT_LT((r.T_world_cam.t - free.frames[i].T_world_cam.t).norm(), 0.02);
    EXPECT_GT(r.own_covariance.trace(), free.frames[i].own_covariance.trace()) << i << ": and it is less sure";
  }
  EXPECT_GE(tracked, 10);
  EXPECT_GT(free.points.back(), free.points[kMasked + 2]) << "of free pictures something does";
}

}  // namespace odometry_test
}  // namespace godwit::vo
