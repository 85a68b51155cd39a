// The mask in small.
#include "vo_core/coarse_mask.h"

#include <gtest/gtest.h>
#include <memory>
#include <vector>

namespace godwit::vo {
namespace {

TEST(CoarseMask, IsLevelThreeOfTheMaskPyramid) {
  std::vector<std::uint8_t> level(40 * 30, 0);
  level[5 * 40 + 7] = 255;
  rt::MaskPyramidView mask;
  mask.levels = rt::kPyramidLevels;
  mask.level[CoarseMask::kLevel] = {level.data(), 40, 30, 40};
  const auto coarse = std::make_unique<CoarseMask>();
  coarse->assign(mask);
  EXPECT_TRUE(coarse->masked(Vec2f(56.0f, 40.0f)));
  EXPECT_TRUE(coarse->masked(Vec2f(63.9f, 47.9f)));
  EXPECT_FALSE(coarse->masked(Vec2f(55.9f, 40.0f)));
  EXPECT_FALSE(coarse->masked(Vec2f(64.0f, 40.0f)));
  EXPECT_FALSE(coarse->masked(Vec2f(325.0f, 5.0f))) << "right of the last whole cell";
  const auto copy = std::make_unique<CoarseMask>();
  copy->assign(*coarse);
  EXPECT_TRUE(copy->masked(Vec2f(60.0f, 44.0f)));
}

TEST(CoarseMask, NoMaskMasksNothing) {
  const auto coarse = std::make_unique<CoarseMask>();
  coarse->assign(rt::MaskPyramidView{});
  EXPECT_TRUE(coarse->empty());
  EXPECT_FALSE(coarse->masked(Vec2f(0.0f, 0.0f)));
}

}  // namespace
}  // namespace godwit::vo
