// Tracker and mapper together on rendered pictures with exact truth: a small sweep, in any order of its pictures.
#pragma once

#include <algorithm>
#include <cstring>
#include <functional>
#include <gtest/gtest.h>
#include <memory>
#include <random>
#include <vector>

#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"
#include "tests/vo_core/synthetic_scene.h"
#include "vo_core/image/pyramid.h"
#include "vo_core/map/mapper.h"
#include "vo_core/tracking/tracker.h"

namespace godwit::vo::test {

inline CameraModel small_camera() {
  return CameraModel::pinhole_radtan(320, 240, 260, 260, 160, 120, {0.05, -0.02, 0, 0, 0}).value();
}

// A sideways sweep with a gentle turn, 60 frames.
inline std::vector<SE3> sweep(int frames) {
  std::vector<SE3> out;
  for (int i = 0; i < frames; ++i) {
    const double s = 0.02 * i;
    out.push_back(
        SE3::exp((Vec6() << -s, 0.12 * std::sin(2.0 * s), 0.05 * std::sin(3.0 * s), 0, 0.06 * s, 0).finished()));
  }
  return out;
}

inline const std::vector<Picture>& pictures() {
  static const std::vector<Picture> all = [] {
    std::vector<Picture> out;
    const SyntheticScene scene = SyntheticScene::general();
    const CameraModel camera = small_camera();
    for (const SE3& T : sweep(60)) out.push_back(scene.render(camera, T));
    return out;
  }();
  return all;
}

// From where the sweep is at frame 40 the camera turns away to the right and comes back.
constexpr int kTurnFrames = 30;
constexpr int kTurned = 1000;  ///< in an order: the first picture of the turn
inline SE3 turn_pose(int i) {
  const double yaw = 1.3 * std::sin(3.141592653589793 * (i + 1) / (kTurnFrames + 1));
  return SE3(so3_exp(Vec3(0, yaw, 0)), Vec3::Zero()) * sweep(60)[40];
}
inline const Picture& turned_picture(int i) {
  static const std::vector<Picture> all = [] {
    std::vector<Picture> out;
    out.reserve(kTurnFrames);
    const SyntheticScene scene = SyntheticScene::general();
    for (int k = 0; k < kTurnFrames; ++k) out.push_back(scene.render(small_camera(), turn_pose(k)));
    return out;
  }();
  return all[static_cast<std::size_t>(i)];
}

/// In an order: a picture of the sweep by lamps on 50 Hz mains, behind a rolling shutter. At 30 pictures a second the
/// dark rows lie elsewhere in each picture, and again there in the third after it.
constexpr int kLamps = 2000;
inline void light_by_lamps(int frame, std::uint8_t* grey) {
  for (int y = 0; y < 240; ++y) {
    const double light = 0.55 * (1.0 + 0.6 * std::sin(2.0 * 3.141592653589793 * (frame / 3.0 + 1.5 * y / 240)));
    for (int x = 0; x < 320; ++x) grey[y * 320 + x] = static_cast<std::uint8_t>(std::lround(light * grey[y * 320 + x]));
  }
}

/// In an order: a picture of the sweep in a mirror, which is another world.
constexpr int kMirrored = 3000;

/// In an order: a picture of nothing that the map knows, each time another one.
constexpr int kElsewhere = -2;
inline void draw_elsewhere(std::size_t seed, std::uint8_t* grey) {
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

constexpr int kMany = 1'000'000;

/// How the mapper keeps up.
struct Pace {
  int delay_frames = 2;
  /// Messages it works on at most after each frame; empty: all that there are.
  std::vector<int> steps;
  /// What each frame is to find of it; empty: what there is.
  std::vector<FrameOrder> orders;
  rt::MaskPyramidView late;  ///< for each keyframe, three frames after it; no levels: none comes late
};

inline Flown run_odometry(const std::vector<int>& order, const rt::MaskPyramidView& mask = {},
                          std::size_t masked_from = 0, const Expectation& expected = nullptr, const Pace& pace = {}) {
  const CameraModel camera = small_camera();
  TrackerOptions options;
  options.delta_delay_frames = pace.delay_frames;
  auto channel = std::make_unique<MapChannel>();
  Tracker tracker(camera, options, channel.get());
  Mapper mapper(camera, MapperOptions{}, channel.get());
  const int stride = 320;
  const std::size_t base = 320 * 240, extra = pyramid_bytes(320, 240, rt::kPyramidLevels);
  constexpr int kSlots = 90;
  std::vector<std::unique_ptr<std::uint8_t[]>> memory;
  std::vector<int> references(kSlots, 0);
  memory.reserve(kSlots);
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
    if (order[i] >= kMirrored) {
      std::memcpy(data, pictures()[static_cast<std::size_t>(order[i] - kMirrored)].view().data, base);
      for (int y = 0; y < 240; ++y) std::reverse(data + y * 320, data + (y + 1) * 320);
    } else if (order[i] >= kLamps) {
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
      if (!pace.orders.empty()) tracker.expect(pace.orders[i]);
      if (pace.late.levels > 0 && i >= 3 && run.frames[i - 3].is_keyframe)
        tracker.late_mask(static_cast<rt::TimeNs>(i - 3) * 33'333'333, pace.late);
      r = tracker.track(in);
      for (int n = pace.steps.empty() ? kMany : pace.steps[i]; n > 0 && mapper.step();) --n;
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

inline std::vector<int> forward(int n) {
  std::vector<int> out;
  out.reserve(static_cast<std::size_t>(n));
  for (int i = 0; i < n; ++i) out.push_back(i);
  return out;
}

}  // namespace godwit::vo::test
