// From boxes to masks as the tracker thread sees it.
#include "firmware_app/dynamic/dynamic_masks.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <gtest/gtest.h>

#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"

namespace godwit::app {
namespace dynamic_masks_test {

constexpr int kWidth = 320, kHeight = 240;

/// A texture that moves to the right.
void draw(const rt::MutableImageView& grey, int time) {
  for (int y = 0; y < grey.height; ++y)
    for (int x = 0; x < grey.width; ++x)
      grey.row(y)[x] = static_cast<std::uint8_t>(128 + 60 * std::sin(0.21 * (x - 3 * time) + 0.05 * y) +
                                                 40 * std::cos(0.17 * y - 0.03 * x));
}

/// A pool of two pictures, and masks made of boxes of anything.
struct Masks {
  Masks() {
    rt::FramePool::Layout layout;
    layout.width = kWidth;
    layout.height = kHeight;
    layout.slots = 2;
    layout.readers = 1;
    pool = std::move(rt::FramePool::create(layout)).value();
    DynamicMasksOptions options;
    options.model = GODWIT_MODEL_DIR "/cbam_yolov5n_320.onnx";
    options.detector.decode.score_threshold = 1e-5F;
    const auto camera = vo::CameraModel::pinhole_radtan(kWidth, kHeight, 250, 250, 159.5, 119.5, {});
    auto opened = DynamicMasks::open(options, camera.value(), pool.get());
    if (!opened) {
      ADD_FAILURE() << opened.error().message;
      std::abort();
    }
    masks = std::move(opened).value();
  }
  std::unique_ptr<rt::FramePool> pool;
  std::unique_ptr<DynamicMasks> masks;
};

TEST(DynamicMasks, ADetectionThatComesTooLateToBeCarriedIsNotKnownOfAKeyframe) {
  const Masks m;
  const int slot = m.pool->acquire();
  draw(m.pool->grey(slot), 0);
  const auto at = [](int frame) { return frame * 33 * rt::kNsPerMs; };
  rt::FrameMeta meta;
  const auto fly_to = [&](int first, int last) {
    for (int frame = first; frame <= last; ++frame) {
      meta.t_capture_ns = at(frame);
      m.masks->mask_for(meta, m.pool->grey(slot));
    }
  };
  const auto detect = [&](int frame) {
    rt::FrameMeta of = meta;
    of.t_capture_ns = at(frame);
    ASSERT_TRUE(m.masks->detect({.frame = {slot, of}}));
  };
  rt::MaskPyramidView late;
  fly_to(1, 27);
  detect(1);
  fly_to(28, 38);
  EXPECT_EQ(m.masks->late_mask(at(20), at(0), &late), at(1));
  detect(5);  // gone from what boxes are carried through
  fly_to(39, 39);
  EXPECT_EQ(m.masks->late_mask(at(20), at(1), &late), at(1));
}

TEST(DynamicMasks, ABoxInWhichNoMotionIsSeenGoesWithTheCamera) {
  // Grey in grey; the camera turns from the first picture on. Half of the masks are told of it.
  const auto masked_after = [](double turn_rad) {
    const Masks m;
    const int slot = m.pool->acquire();
    draw(m.pool->grey(slot), 0);
    rt::FrameMeta meta;
    rt::MaskPyramidView mask;
    for (int frame = 0; frame < 6; ++frame) {
      meta.t_capture_ns = (frame + 1) * 33 * rt::kNsPerMs;
      if (frame == 1) {
        EXPECT_TRUE(m.masks->detect({.frame = {slot, meta}}));  // boxes of the texture
        const rt::MutableImageView grey = m.pool->grey(slot);
        for (int y = 0; y < grey.height; ++y) std::fill_n(grey.row(y), grey.width, std::uint8_t{90});
      }
      mask = m.masks->mask_for(meta, m.pool->grey(slot));
      m.masks->frame_tracked(
          {meta.t_capture_ns, 1, vo::SE3(vo::so3_exp(vo::Vec3(0, turn_rad * frame, 0)), vo::Vec3::Zero()), {}});
    }
    std::vector<std::uint8_t> out;
    for (int y = 0; y < mask.level[0].height; ++y)
      out.insert(out.end(), mask.level[0].row(y), mask.level[0].row(y) + mask.level[0].width);
    return out;
  };
  const auto still = masked_after(0.0), turned = masked_after(0.03);
  EXPECT_GT(std::count(still.begin(), still.end(), 0), 0) << "something must be free";
  EXPECT_NE(still, turned);
  EXPECT_EQ(still, masked_after(0.0)) << "nothing else makes the difference";
}

TEST(DynamicMasks, NothingIsAllocatedOnTheTrackerThread) {
  const Masks made;
  const rt::FramePool* const pool = made.pool.get();
  DynamicMasks* const masks = made.masks.get();

  std::vector<SeenPoint> points;
  points.reserve(150);
  for (int i = 0; i < 150; ++i) points.push_back({2.F * static_cast<float>(i), 1.5F * static_cast<float>(i), 10.F});
  constexpr int kPeriod = 10, kLate = 3;
  int slot = made.pool->acquire(), looked_at = made.pool->acquire();
  ASSERT_GE(looked_at, 0);
  rt::FrameMeta meta, looked_at_meta;
  int masked_frames = 0, late_masks = 0;
  const rt::HeapCounts before = rt::rt_heap_counts();
  for (int frame = 0; frame < 100; ++frame) {
    meta.t_capture_ns = (frame + 1) * 33 * rt::kNsPerMs;
    draw(pool->grey(slot), frame);
    // As on a thread of its own: may allocate, and comes late.
    if (frame >= kLate && frame % kPeriod == kLate) {
      EXPECT_TRUE(masks->detect({.frame = {looked_at, looked_at_meta}}));
    }
    rt::MaskPyramidView mask;
    {
      const rt::RtScope scope;
      mask = masks->mask_for(meta, pool->grey(slot));
      // Since the detection's picture more is known of each than when it was masked; of this one and those before, not.
      rt::MaskPyramidView late;
      constexpr rt::TimeNs kNothing = -1, kStep = 33 * rt::kNsPerMs;
      EXPECT_EQ(masks->late_mask(meta.t_capture_ns, kNothing, &late), kNothing);
      const bool came = frame >= kLate && frame % kPeriod == kLate;
      const rt::TimeNs t_detection = masks->late_mask(meta.t_capture_ns - kStep, kNothing, &late);
      EXPECT_EQ(t_detection, came ? looked_at_meta.t_capture_ns : kNothing);
      late_masks += t_detection != kNothing;
      if (came) {
        EXPECT_EQ(masks->late_mask(looked_at_meta.t_capture_ns - kStep, kNothing, &late), kNothing);
        EXPECT_EQ(masks->late_mask(meta.t_capture_ns - kStep, t_detection, &late), t_detection) << "known already";
      }
      masks->frame_tracked({meta.t_capture_ns, 1, {}, points});
    }
    ASSERT_EQ(mask.levels, rt::kPyramidLevels);
    const rt::ImageView& coarse = mask.level[static_cast<std::size_t>(mask.levels - 1)];
    bool any = false;
    for (int y = 0; y < coarse.height; ++y)
      for (int x = 0; x < coarse.width; ++x) any |= coarse.row(y)[x] != 0;
    if (frame > kLate) masked_frames += any;
    if (frame % kPeriod == 0) {
      std::swap(slot, looked_at);
      looked_at_meta = meta;
    }
  }
  EXPECT_EQ(rt::rt_heap_counts().allocations, before.allocations);
  EXPECT_EQ(rt::rt_heap_counts().frees, before.frees);
  EXPECT_EQ(late_masks, 10);
  EXPECT_GT(masked_frames, 50) << "boxes must have come, or nothing was tried";
}

}  // namespace dynamic_masks_test
}  // namespace godwit::app
