// A mask that comes after its frame has become a keyframe: the map loses what the keyframe took from movers.
#include <algorithm>
#include <gtest/gtest.h>
#include <memory>
#include <new>
#include <vector>

#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"
#include "tests/vo_core/synthetic_scene.h"
#include "vo_core/image/pyramid.h"
#include "vo_core/map/mapper.h"
#include "vo_core/tracking/tracker.h"

namespace godwit::vo {
namespace late_mask_test {

constexpr int kWidth = 320, kHeight = 240, kFrames = 24;
constexpr rt::TimeNs kInterval = 33'333'333;

/// A sideways sweep through tracker and mapper, every picture in memory of its own.
class Flight {
 public:
  Flight()
      : camera_(CameraModel::pinhole_radtan(kWidth, kHeight, 260, 260, 160, 120, {0.05, -0.02, 0, 0, 0}).value()),
        tracker_(camera_, {}, &channel_),
        mapper_(camera_, {}, &channel_) {
    for (int i = 0; i < kFrames; ++i) fly(i);
  }
  ~Flight() {
    for (std::uint8_t* p : memory_) ::operator delete[](p, std::align_val_t(rt::kRowAlignment));
  }
  Flight(const Flight&) = delete;
  Flight& operator=(const Flight&) = delete;

  Tracker& tracker() { return tracker_; }
  Mapper& mapper() { return mapper_; }
  /// Flies on until the tracker has taken all that the mapper found out: a delta a frame.
  void settle() {
    for (int i = 0; i < 4; ++i) fly(static_cast<int>(memory_.size()));
  }
  /// Capture time of the newest keyframe.
  rt::TimeNs newest_keyframe() const { return t_keyframe_ns_; }

 private:
  static const test::Picture& picture(const CameraModel& camera, int i) {
    static std::vector<test::Picture> all;
    static const test::SyntheticScene scene = test::SyntheticScene::general();
    for (int k = static_cast<int>(all.size()); k <= i; ++k) {
      const double s = 0.02 * k;
      all.push_back(scene.render(camera, SE3::exp((Vec6() << -s, 0, 0, 0, 0.06 * s, 0).finished())));
    }
    return all[static_cast<std::size_t>(i)];
  }

  void fly(int i) {
    const std::size_t base = static_cast<std::size_t>(kWidth * kHeight);
    const std::size_t extra = pyramid_bytes(kWidth, kHeight, rt::kPyramidLevels);
    auto* data = new (std::align_val_t(rt::kRowAlignment)) std::uint8_t[base + extra];
    memory_.push_back(data);
    std::copy_n(picture(camera_, i).view().data, base, data);
    FrameInput in;
    in.grey = {data, kWidth, kHeight, kWidth};
    in.pyramid_storage = data + base;
    in.pyramid_bytes = extra;
    in.slot = i;
    in.sequence = static_cast<std::uint32_t>(i);
    in.t_capture_ns = (i + 1) * kInterval;
    if (tracker_.track(in).is_keyframe) t_keyframe_ns_ = in.t_capture_ns;
    while (mapper_.step()) {
    }
    SlotRelease unused;
    while (tracker_.take_release(&unused) || mapper_.take_release(&unused)) {
    }
  }

  const CameraModel camera_;
  MapChannel channel_;
  Tracker tracker_;
  Mapper mapper_;
  std::vector<std::uint8_t*> memory_;
  rt::TimeNs t_keyframe_ns_ = 0;
};

/// The left half of the picture at all levels.
struct LeftHalf {
  LeftHalf() {
    view.levels = rt::kPyramidLevels;
    for (int l = 0; l < view.levels; ++l) {
      const int w = kWidth >> l, h = kHeight >> l;
      std::vector<std::uint8_t>& pixels = storage[static_cast<std::size_t>(l)];
      for (int i = 0; i < w * h; ++i) pixels.push_back(i % w < w / 2 ? 255 : 0);
      view.level[static_cast<std::size_t>(l)] = rt::ImageView{pixels.data(), w, h, w};
    }
  }
  std::array<std::vector<std::uint8_t>, rt::kPyramidLevels> storage;
  rt::MaskPyramidView view;
};

struct Halves {
  int left = 0, right = 0;
  int left_proved = 0;         ///< by two other keyframes
  int left_proved_beside = 0;  ///< by two that saw it in their right half
};
/// Features of the keyframe captured then that have a point.
Halves count(const Map& map, rt::TimeNs t_capture_ns) {
  Halves out;
  for (int k = 0; k < kMaxKeyframes; ++k) {
    const Keyframe& kf = map.keyframe(k);
    if (kf.id == 0 || kf.t_capture_ns != t_capture_ns) continue;
    for (int i = 0; i < kf.feature_count; ++i) {
      const KeyframeFeature& f = kf.features[static_cast<std::size_t>(i)];
      const MapPoint* const p = map.find(f.point);
      if (p == nullptr) continue;
      ++(f.px.x() < kWidth / 2 ? out.left : out.right);
      int beside = 0;
      for (int o = 0; o < p->observation_count; ++o) {
        const Observation& seen = p->observations[static_cast<std::size_t>(o)];
        beside += map.keyframe(seen.keyframe).features[seen.feature].px.x() >= kWidth / 2;
      }
      out.left_proved += f.px.x() < kWidth / 2 && p->observation_count >= 3;
      out.left_proved_beside += f.px.x() < kWidth / 2 && beside >= 2;
    }
  }
  return out;
}

TEST(LateMask, TakesFromTheMapWhatItsKeyframeAloneSaw) {
  Flight flight;
  const LeftHalf mask;
  const rt::TimeNs t = flight.newest_keyframe();
  const Halves before = count(flight.mapper().map(), t);
  ASSERT_GT(before.left, before.left_proved) << "there is something to take";
  ASSERT_GT(before.left_proved, 0);
  {
    const rt::RtScope scope;
    const std::uint64_t allocations = rt::rt_heap_counts().allocations;
    EXPECT_TRUE(flight.tracker().late_mask(t, mask.view));
    EXPECT_TRUE(flight.mapper().step());
    EXPECT_EQ(rt::rt_heap_counts().allocations, allocations);
  }
  const Halves after = count(flight.mapper().map(), t);
  EXPECT_EQ(after.left, before.left_proved) << "a box holds much that stands still: what others have seen stays";
  EXPECT_EQ(after.right, before.right);
  flight.settle();
  // No seed that began inside becomes a point any more; both maps agree.
  for (const Map* map : {&flight.tracker().map(), &flight.mapper().map()})
    EXPECT_LE(count(*map, t).left, before.left_proved);
}

TEST(LateMask, WhatIsMaskedInTheOtherKeyframesTooIsNoProof) {
  Flight flight;
  const LeftHalf mask;
  const rt::TimeNs newest = flight.newest_keyframe();
  // Somebody was in the picture from the first keyframe on, and all their masks come late.
  std::vector<rt::TimeNs> times;
  const Map& map = flight.mapper().map();
  for (int k = 0; k < kMaxKeyframes; ++k)
    if (map.keyframe(k).id != 0) times.push_back(map.keyframe(k).t_capture_ns);
  ASSERT_GE(times.size(), 3u);
  std::sort(times.begin(), times.end());
  for (const rt::TimeNs t : times) {
    EXPECT_TRUE(flight.tracker().late_mask(t, mask.view));
    while (flight.mapper().step()) {
    }
  }
  const Halves after = count(map, newest);
  EXPECT_EQ(after.left_proved_beside, after.left);
  EXPECT_GT(after.right, 10);
}

TEST(LateMask, OfAFrameThatIsNoKeyframeChangesNothing) {
  Flight flight;
  const LeftHalf mask;
  const int points = flight.mapper().map().point_count();
  EXPECT_TRUE(flight.tracker().late_mask(flight.newest_keyframe() + 1, mask.view));
  EXPECT_FALSE(flight.mapper().step()) << "nothing was sent";
  EXPECT_EQ(flight.mapper().map().point_count(), points);
}

TEST(LateMask, WithoutRoomForTheMessageItIsToBeTriedAgain) {
  Flight flight;
  const LeftHalf mask;
  bool sent = true;
  for (int i = 0; i < 40 && sent; ++i) sent = flight.tracker().late_mask(flight.newest_keyframe(), mask.view);
  EXPECT_FALSE(sent);
  while (flight.mapper().step()) {
  }
  flight.settle();  // room is looked at once a frame
  EXPECT_TRUE(flight.tracker().late_mask(flight.newest_keyframe(), mask.view));
}

}  // namespace late_mask_test
}  // namespace godwit::vo
