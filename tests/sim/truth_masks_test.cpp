#include "firmware_app/sim/truth_masks.h"

#include <atomic>
#include <gtest/gtest.h>
#include <thread>
#include <vector>

namespace godwit::app {
namespace {

sim::TrueBox box(double x0, double y0, double x1, double y1) {
  return {0, sim::MoverKind::kCar, false, x0, y0, x1, y1, 1};
}
rt::FrameMeta frame(std::uint32_t sequence) {
  return {0, 0, sequence};
}
bool masked(const rt::MaskPyramidView& mask, int level, int x, int y) {
  return mask.level[static_cast<std::size_t>(level)].row(y)[x] != 0;
}

TEST(TruthMasks, EachFrameGetsItsOwnBoxesAtAllLevels) {
  TruthMasks masks(320, 240);
  masks.put(0, std::vector{box(10, 20, 50, 60)});
  masks.put(1, std::vector{box(200, 100, 240, 160)});
  const rt::MaskPyramidView first = masks.mask_for(frame(0), {});
  ASSERT_EQ(first.levels, rt::kPyramidLevels);
  EXPECT_TRUE(masked(first, 0, 30, 40));
  EXPECT_TRUE(masked(first, 2, 7, 10));
  EXPECT_FALSE(masked(first, 0, 220, 130));
  const rt::MaskPyramidView second = masks.mask_for(frame(1), {});
  EXPECT_FALSE(masked(second, 0, 30, 40));
  EXPECT_TRUE(masked(second, 0, 220, 130));
  EXPECT_EQ(masks.mask_for(frame(2), {}).levels, 0) << "nothing is known of a picture whose boxes were not put";
}

TEST(TruthMasks, BoxesOfDroppedPicturesAreThrownAway) {
  TruthMasks masks(320, 240);
  for (std::uint32_t i = 0; i < 5; ++i) masks.put(i, std::vector{box(20.0 * i, 0, 20.0 * i + 8, 8)});
  const rt::MaskPyramidView mask = masks.mask_for(frame(3), {});
  ASSERT_EQ(mask.levels, rt::kPyramidLevels);
  EXPECT_TRUE(masked(mask, 0, 64, 4));
  EXPECT_FALSE(masked(mask, 0, 44, 4));
  EXPECT_EQ(masks.mask_for(frame(3), {}).levels, 0) << "asked once a frame";
  EXPECT_TRUE(masked(masks.mask_for(frame(4), {}), 0, 84, 4));
}

TEST(TruthMasks, FromThreadToThreadNothingIsMixedUp) {
  TruthMasks masks(640, 48);
  constexpr std::uint32_t kFrames = 2000;
  std::atomic<std::uint32_t> through{0};
  std::thread camera([&] {
    for (std::uint32_t i = 0; i < kFrames; ++i) {
      while (i - through.load() > 16) std::this_thread::sleep_for(std::chrono::microseconds(1));
      masks.put(i, std::vector{box(10.0 * (i % 60), 10, 10.0 * (i % 60) + 4, 14)});
    }
  });
  std::uint32_t right = 0;
  for (std::uint32_t i = 0; i < kFrames; ++i) {
    rt::MaskPyramidView mask;
    while ((mask = masks.mask_for(frame(i), {})).levels == 0) std::this_thread::sleep_for(std::chrono::microseconds(1));
    const int x = static_cast<int>(i % 60) * 10 + 2;
    right += masked(mask, 0, x, 12) && !masked(mask, 0, (x + 300) % 600, 12) ? 1 : 0;
    through.store(i + 1);
  }
  camera.join();
  EXPECT_EQ(right, kFrames);
}

}  // namespace
}  // namespace godwit::app
