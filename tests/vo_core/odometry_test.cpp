// Tracker and mapper together on rendered pictures with exact truth.
#include <cstring>
#include <functional>
#include <gtest/gtest.h>
#include <memory>
#include <random>
#include <vector>

#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"
#include "tests/vo_core/synthetic_scene.h"
#include "vo_core/mapper.h"
#include "vo_core/pyramid.h"
#include "vo_core/tracker.h"

namespace godwit::vo {
namespace odometry_test {

CameraModel small_camera() {
  return CameraModel::pinhole_radtan(320, 240, 260, 260, 160, 120, {0.05, -0.02, 0, 0, 0}).value();
}

// A sideways sweep with a gentle turn, 60 frames.
std::vector<SE3> sweep(int frames) {
  std::vector<SE3> out;
  for (int i = 0; i < frames; ++i) {
    const double s = 0.02 * i;
    out.push_back(
        SE3::exp((Vec6() << -s, 0.12 * std::sin(2.0 * s), 0.05 * std::sin(3.0 * s), 0, 0.06 * s, 0).finished()));
  }
  return out;
}

const std::vector<test::Picture>& pictures() {
  static const std::vector<test::Picture> all = [] {
    std::vector<test::Picture> out;
    const test::SyntheticScene scene = test::SyntheticScene::general();
    const CameraModel camera = small_camera();
    for (const SE3& T : sweep(60)) out.push_back(scene.render(camera, T));
    return out;
  }();
  return all;
}

// From where the sweep is at frame 40 the camera turns away to the right and comes back.
constexpr int kTurnFrames = 30;
constexpr int kTurned = 1000;  ///< in an order: the first picture of the turn
SE3 turn_pose(int i) {
  const double yaw = 1.3 * std::sin(3.141592653589793 * (i + 1) / (kTurnFrames + 1));
  return SE3(so3_exp(Vec3(0, yaw, 0)), Vec3::Zero()) * sweep(60)[40];
}
const test::Picture& turned_picture(int i) {
  static const std::vector<test::Picture> all = [] {
    std::vector<test::Picture> out;
    const test::SyntheticScene scene = test::SyntheticScene::general();
    for (int k = 0; k < kTurnFrames; ++k) out.push_back(scene.render(small_camera(), turn_pose(k)));
    return out;
  }();
  return all[static_cast<std::size_t>(i)];
}

/// In an order: a picture of the sweep by lamps on 50 Hz mains, behind a rolling shutter. At 30 pictures a second the
/// dark rows lie elsewhere in each picture, and again there in the third after it.
constexpr int kLamps = 2000;
void light_by_lamps(int frame, std::uint8_t* grey) {
  for (int y = 0; y < 240; ++y) {
    const double light = 0.55 * (1.0 + 0.6 * std::sin(2.0 * 3.141592653589793 * (frame / 3.0 + 1.5 * y / 240)));
    for (int x = 0; x < 320; ++x) grey[y * 320 + x] = static_cast<std::uint8_t>(std::lround(light * grey[y * 320 + x]));
  }
}

/// In an order: a picture of nothing that the map knows, each time another one.
constexpr int kElsewhere = -2;
void draw_elsewhere(std::size_t seed, std::uint8_t* grey) {
  std::minstd_rand engine(static_cast<unsigned>(seed + 1));
  for (int block = 0; block < 20 * 15; ++block) {
    const int value = static_cast<int>(engine() % 200);
    for (int y = 0; y < 16; ++y) std::memset(grey + (block / 20 * 16 + y) * 320 + block % 20 * 16, value, 16);
  }
}

struct Flown {
  std::vector<FrameResult> frames;
  std::vector<int> points;  ///< in the tracker's map after each frame
  std::uint64_t allocations = 0;
  int slots_out = 0;
};

/// Where the camera should be at a picture, by what was tracked until then.
using Expectation = std::function<PosePrior(std::size_t, const Flown&)>;

Flown run_odometry(const std::vector<int>& order, const rt::MaskPyramidView& mask = {}, std::size_t masked_from = 0,
                   const Expectation& expected = nullptr) {
  const CameraModel camera = small_camera();
  TrackerOptions options;
  options.delta_delay_frames = 2;
  auto channel = std::make_unique<MapChannel>();
  Tracker tracker(camera, options, channel.get());
  Mapper mapper(camera, MapperOptions{}, channel.get());
  const int stride = 320;
  const std::size_t base = 320 * 240, extra = pyramid_bytes(320, 240, rt::kPyramidLevels);
  constexpr int kSlots = 90;
  std::vector<std::unique_ptr<std::uint8_t[]>> memory;
  std::vector<int> references(kSlots, 0);
  for (int i = 0; i < kSlots; ++i) memory.emplace_back(new (std::align_val_t(64)) std::uint8_t[base + extra + 128]());
  Flown run;
  bool have_pose = false;
  for (std::size_t i = 0; i < order.size(); ++i) {
    int slot = 0;
    while (slot < kSlots && references[static_cast<std::size_t>(slot)] > 0) ++slot;
    if (slot == kSlots) {
      ADD_FAILURE() << "references are not given back";
      break;
    }
    std::uint8_t* data = memory[static_cast<std::size_t>(slot)].get();
    if (order[i] >= kLamps) {
      std::memcpy(data, pictures()[static_cast<std::size_t>(order[i] - kLamps)].view().data, base);
      light_by_lamps(order[i], data);
    } else if (order[i] >= kTurned) {
      std::memcpy(data, turned_picture(order[i] - kTurned).view().data, base);
    } else if (order[i] >= 0) {
      std::memcpy(data, pictures()[static_cast<std::size_t>(order[i])].view().data, base);
    } else if (order[i] == kElsewhere) {
      draw_elsewhere(i, data);
    } else {
      std::memset(data, static_cast<int>(i % 3), base);  // black, but not the very same picture each time
    }
    references[static_cast<std::size_t>(slot)] = 2;
    FrameInput in;
    in.grey = {data, 320, 240, stride};
    in.pyramid_storage = data + base;
    in.pyramid_bytes = extra;
    if (i >= masked_from) in.mask = mask;
    in.slot = slot;
    in.sequence = static_cast<std::uint32_t>(i);
    in.t_capture_ns = static_cast<rt::TimeNs>(i) * 33'333'333;
    if (expected) in.expected = expected(i, run);
    FrameResult r;
    {
      const rt::RtScope scope;
      const std::uint64_t before = rt::rt_heap_counts().allocations;
      r = tracker.track(in);
      while (mapper.step()) {
      }
      if (have_pose) run.allocations += rt::rt_heap_counts().allocations - before;
    }
    have_pose |= r.tracked;
    SlotRelease release;
    while (tracker.take_release(&release)) references[static_cast<std::size_t>(release.slot)] -= release.count;
    while (mapper.take_release(&release)) references[static_cast<std::size_t>(release.slot)] -= release.count;
    for (int n : references) EXPECT_GE(n, 0);
    run.frames.push_back(r);
    run.points.push_back(tracker.map().point_count());
  }
  for (int n : references) run.slots_out += n > 0;
  for (auto& m : memory) ::operator delete[](m.release(), std::align_val_t(64));
  return run;
}

std::vector<int> forward(int n) {
  std::vector<int> out;
  for (int i = 0; i < n; ++i) out.push_back(i);
  return out;
}

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

TEST(Odometry, BlackFramesAreNotTrackedAndTheViewIsFoundAgain) {
  std::vector<int> order = forward(40);
  for (int i = 0; i < 6; ++i) order.push_back(-1);
  for (int i = 39; i < 45; ++i) order.push_back(i);
  const Flown run = run_odometry(order);
  ASSERT_TRUE(run.frames[39].tracked);
  for (std::size_t i = 40; i < 46; ++i) {
    EXPECT_FALSE(run.frames[i].tracked) << i;
    EXPECT_EQ(run.frames[i].state, State::kRelocalising);
    EXPECT_GT(run.frames[i].reason_limit, run.frames[i].reason_value);
  }
  EXPECT_TRUE(run.frames.back().tracked);
  EXPECT_EQ(run.frames.back().map_id, run.frames[39].map_id);
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

/// The sweep's truth in the map's frame and unit: the map's unit from the first `known` pictures.
SE3 in_map(const Flown& run, std::size_t known, int picture) {
  const std::vector<SE3> truth = sweep(60);
  double num = 0, den = 0;
  for (std::size_t i = 0; i < known; ++i) {
    if (!run.frames[i].tracked) continue;
    num += (truth[0] * truth[i].inverse()).t.dot(run.frames[i].T_world_cam.t);
    den += run.frames[i].T_world_cam.t.squaredNorm();
  }
  SE3 T_world_cam = truth[0] * truth[static_cast<std::size_t>(picture)].inverse();
  T_world_cam.t *= den / num;
  return T_world_cam;
}

// The sweep goes on in the dark, until hardly anything looks as it did: by likeness the map is not found there. A sensor
// that felt the way knows where to look, if only about.
TEST(Odometry, AViewThatLooksLikeNoneIsFoundWhereTheCameraShouldBe) {
  std::vector<int> order = forward(25);
  for (int i = 0; i < 60; ++i) order.push_back(-1);
  for (int i = 54; i < 60; ++i) order.push_back(i);
  const auto felt = [&](std::size_t i, const Flown& run) {
    PosePrior prior;
    if (i < 25 || order[i] < 0) return prior;
    SE3 T_world_cam = in_map(run, 25, order[i]);
    T_world_cam = SE3(so3_exp(Vec3(0.01, -0.01, 0.01)), Vec3(0.02, -0.02, 0.02)) * T_world_cam;
    prior.known = true;
    prior.map_id = 1;
    prior.T_cam_map = T_world_cam.inverse();
    return prior;
  };
  const Flown by_likeness = run_odometry(order), run = run_odometry(order, {}, 0, felt);
  ASSERT_TRUE(run.frames[24].tracked);
  EXPECT_FALSE(by_likeness.frames[86].tracked) << "else this test shows nothing";
  EXPECT_TRUE(run.frames[86].tracked) << run.frames[85].reason << ", " << run.frames[86].reason;
  EXPECT_EQ(run.frames[86].map_id, run.frames[24].map_id);
  EXPECT_LT((run.frames[86].T_world_cam.t - in_map(run, 25, order[86]).t).norm(), 0.02);
  // Of another map nothing is expected.
  const auto stale = [&](std::size_t i, const Flown& sofar) {
    PosePrior prior = felt(i, sofar);
    prior.map_id = 7;
    return prior;
  };
  EXPECT_FALSE(run_odometry(order, {}, 0, stale).frames[86].tracked);
}

TEST(Odometry, ACoveredLensGivesNothingUp) {
  std::vector<int> order = forward(30);
  for (int i = 0; i < TrackerOptions{}.health.give_up_ns / 33'333'333 + 30; ++i) order.push_back(-1);
  for (int i = 29; i < 36; ++i) order.push_back(i);
  const Flown run = run_odometry(order);
  ASSERT_TRUE(run.frames[29].tracked);
  ASSERT_TRUE(run.frames.back().tracked);
  EXPECT_EQ(run.frames.back().map_id, run.frames[29].map_id) << "in the dark nothing was searched";
}

TEST(Odometry, AfterTooLongWithoutAPoseANewMapBegins) {
  std::vector<int> order = forward(30);
  // Another view altogether.
  for (int i = 0; i < TrackerOptions{}.health.give_up_ns / 33'333'333 + 4; ++i) order.push_back(kElsewhere);
  for (int i = 0; i < 30; ++i) order.push_back(i);
  const Flown run = run_odometry(order);
  ASSERT_TRUE(run.frames[29].tracked);
  ASSERT_TRUE(run.frames.back().tracked);
  EXPECT_EQ(run.frames.back().map_id, run.frames[29].map_id + 1);
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

TEST(Odometry, AViewFarFromTheLastOneIsFoundByItsKeyframeAndConfirmed) {
  std::vector<int> order = forward(60);
  for (int i = 0; i < 20; ++i) order.push_back(-1);
  for (int i = 10; i < 20; ++i) order.push_back(i);  // back at the beginning
  const Flown run = run_odometry(order);
  ASSERT_TRUE(run.frames[59].tracked);
  std::size_t back = 80;
  while (back < run.frames.size() && !run.frames[back].tracked) ++back;
  ASSERT_LT(back, 88u) << "not found within eight frames";
  EXPECT_GT(back, 80u) << "one frame must confirm it";
  EXPECT_EQ(run.frames[back].map_id, run.frames[59].map_id);
  // The same picture was flown before: the pose must be that one again.
  const auto before = static_cast<std::size_t>(order[back]);
  EXPECT_LT((run.frames[back].T_world_cam.t - run.frames[before].T_world_cam.t).norm(), 0.03);
}

TEST(Odometry, ACameraTurnedAwayAndBackIsRightWhereItSaysTracked) {
  std::vector<int> order = forward(41);
  for (int i = 0; i < kTurnFrames; ++i) order.push_back(kTurned + i);
  for (int i = 40; i < 52; ++i) order.push_back(i);
  const Flown run = run_odometry(order);
  ASSERT_TRUE(run.frames[40].tracked);
  const std::vector<SE3> truth = sweep(60);
  // Unit of the map: from the way before the turn.
  double num = 0, den = 0;
  for (std::size_t i = 0; i < 41; ++i) {
    if (!run.frames[i].tracked) continue;
    num += (truth[0] * truth[i].inverse()).t.dot(run.frames[i].T_world_cam.t);
    den += run.frames[i].T_world_cam.t.squaredNorm();
  }
  const double scale = num / den;
  int after = 0, lost = 0;
  for (std::size_t i = 41; i < run.frames.size(); ++i) {
    const bool turn = order[i] >= kTurned;
    lost += turn && !run.frames[i].tracked;
    if (!run.frames[i].tracked) continue;
    after += !turn;
    const SE3 T = order[i] >= kTurned ? turn_pose(order[i] - kTurned) : truth[static_cast<std::size_t>(order[i])];
    const Mat3 dR = run.frames[i].T_world_cam.R.transpose() * truth[0].R * T.R.transpose();
    EXPECT_LT(so3_log(dR).norm(), 0.05) << i;
    EXPECT_LT((scale * run.frames[i].T_world_cam.t - (truth[0] * T.inverse()).t).norm(), 0.05) << i;
  }
  // It turns by 7 degrees a frame to where there is nothing of the map; the first few frames of the turn still see it.
  EXPECT_GE(lost, 15);
  EXPECT_GE(after, 5) << "or nothing above has been judged";
  EXPECT_TRUE(run.frames.back().tracked);
  EXPECT_EQ(run.frames.back().map_id, run.frames[40].map_id);
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
