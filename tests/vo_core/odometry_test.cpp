// Tracker and mapper together on rendered pictures with exact truth.
#include <algorithm>
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
using test::Pace;
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
    const Vec3 t = truth[0] * truth[i].centre();
    num += t.dot(run.frames[i].T_world_cam.t);
    den += run.frames[i].T_world_cam.t.squaredNorm();
  }
  const double scale = num / den;
  double worst = 0, worst_angle = 0;
  for (std::size_t i = first; i < run.frames.size(); ++i) {
    const Vec3 t = truth[0] * truth[i].centre();
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

rt::MaskPyramidView mask_of_a_corner() {
  static const std::vector<std::uint8_t> cells = [] {
    std::vector<std::uint8_t> out(320 * 240, 0);
    for (int y = 0; y < 100; ++y) std::memset(out.data() + y * 320, 255, 10);
    return out;
  }();
  rt::MaskPyramidView mask;
  mask.levels = rt::kPyramidLevels;
  for (int l = 0; l < mask.levels; ++l)
    mask.level[static_cast<std::size_t>(l)] = {cells.data(), 320 >> l, 240 >> l, 320};
  return mask;
}

/// Frames of which something is not equal to the bit.
int unequal(const Flown& a, const Flown& b) {
  int out = 0;
  for (std::size_t i = 0; i < a.frames.size(); ++i) {
    const FrameResult &p = a.frames[i], &q = b.frames[i];
    const bool equal = p.state == q.state && p.tracked == q.tracked && p.is_keyframe == q.is_keyframe &&
                       p.map_id == q.map_id && p.measurements == q.measurements && p.T_world_cam.R == q.T_world_cam.R &&
                       p.T_world_cam.t == q.T_world_cam.t && p.covariance == q.covariance && a.points[i] == b.points[i];
    out += equal ? 0 : 1;
  }
  return out;
}

// A mapper beside the flight is now quick, now slow, and once away for a while; what each frame found of it is all that
// must be known.
TEST(Odometry, AFlightBesideASlowMapperIsFlownAgainToTheBit) {
  std::vector<int> order = forward(50);
  for (int i = 0; i < 5; ++i) order.push_back(-1);
  for (int i = 49; i > 5; --i) order.push_back(i);
  for (int i = 0; i < 160; ++i) order.push_back(test::kElsewhere);  // until the map is given up
  for (int i = 0; i < 60; ++i) order.push_back(test::kMirrored + i);
  Pace beside;
  beside.delay_frames = 0;
  beside.late = mask_of_a_corner();
  std::uint32_t random = 1;
  for (std::size_t i = 0; i < order.size(); ++i) {
    random = random * 1664525 + 1013904223;
    const bool away = (i >= 20 && i < 45) || i % 90 > 80;
    beside.steps.push_back(away ? 0 : static_cast<int>((random >> 16) % 3));
  }
  const Flown flown = run_odometry(order, {}, 0, nullptr, beside);
  int full = 0, none = 0, tracked = 0;
  Pace again = beside;
  again.steps.clear();
  for (const FrameResult& r : flown.frames) {
    again.orders.push_back(r.order);
    full += r.order.room < 4 ? 1 : 0;
    none += r.order.deltas == 0 ? 1 : 0;
    tracked += r.tracked ? 1 : 0;
  }
  EXPECT_GT(full, 5) << "the mapper was never slow";
  EXPECT_GT(none, 20);
  EXPECT_GT(tracked, 100);
  EXPECT_GT(flown.frames.back().map_id, 1u) << "a second map is flown again, too";
  EXPECT_EQ(unequal(flown, run_odometry(order, {}, 0, nullptr, again)), 0);
  again.orders.clear();
  EXPECT_GT(unequal(flown, run_odometry(order, {}, 0, nullptr, again)), 50)
      << "without them it would be another flight";
}

// A log of another program may tell of a mapper that had room where this one has none: its deltas are never fetched, so
// it stands.
TEST(Odometry, AnOrderThatThisFlightCannotMeetIsNoHarm) {
  Pace of_another;
  of_another.late = mask_of_a_corner();
  of_another.orders.assign(60, FrameOrder{100, 0});
  const Flown flown = run_odometry(forward(60), {}, 0, nullptr, of_another);
  ASSERT_EQ(flown.frames.size(), 60u);
  EXPECT_EQ(flown.frames.back().order.room, 0) << "what there was, not what was told";
  const auto tracked =
      std::count_if(flown.frames.begin(), flown.frames.end(), [](const FrameResult& r) { return r.tracked; });
  EXPECT_GT(tracked, 10);
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
  order.reserve(60);
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
  // 0.7 s later: long enough ago to be a guess, and found without doubt.
  for (std::size_t i = 60; i < 62; ++i) {
    ASSERT_TRUE(run.frames[i].tracked) << i << ": " << run.frames[i].reason;
    EXPECT_EQ(run.frames[i].map_id, run.frames[39].map_id);
    EXPECT_GT(run.frames[i].median_depth, 0.0);
    EXPECT_LT((run.frames[i].T_world_cam.t - moving.frames[i - 20].T_world_cam.t).norm(), 0.01);
  }
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
