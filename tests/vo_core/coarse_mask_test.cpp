// The mask in small.
#include "vo_core/image/coarse_mask.h"

#include <algorithm>
#include <gtest/gtest.h>
#include <memory>
#include <vector>

namespace godwit::vo {
namespace coarse_mask_test {

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

TEST(CoveredShare, IsWhatTheMaskInSmallTells) {
  EXPECT_EQ(covered_share({}), 0.0);
  std::vector<std::uint8_t> level(40 * 30, 0);
  std::fill_n(level.begin(), 240, std::uint8_t{255});
  rt::MaskPyramidView mask;
  mask.levels = rt::kPyramidLevels;
  mask.level[CoarseMask::kLevel] = {level.data(), 40, 30, 40};
  EXPECT_DOUBLE_EQ(covered_share(mask), 0.2);
  const auto coarse = std::make_unique<CoarseMask>();
  coarse->assign(mask);
  EXPECT_DOUBLE_EQ(coarse->covered(), covered_share(mask));
}

TEST(CoarseMask, TellsHowMuchIsCoveredAndWhatWasLaidBare) {
  std::vector<std::uint8_t> before(40 * 30, 0), now(40 * 30, 0);
  for (std::size_t x = 0; x < 20; ++x)
    for (std::size_t y = 0; y < 30; ++y) before[y * 40 + x] = 255;  // the left half
  for (std::size_t x = 10; x < 30; ++x)
    for (std::size_t y = 0; y < 30; ++y) now[y * 40 + x] = 255;  // moved on by a quarter
  rt::MaskPyramidView mask, later;
  mask.levels = later.levels = rt::kPyramidLevels;
  mask.level[CoarseMask::kLevel] = {before.data(), 40, 30, 40};
  later.level[CoarseMask::kLevel] = {now.data(), 40, 30, 40};
  const auto coarse = std::make_unique<CoarseMask>();
  EXPECT_EQ(coarse->covered(), 0.0);
  EXPECT_EQ(coarse->uncovered(later), 0.0) << "nothing was covered";
  coarse->assign(mask);
  EXPECT_DOUBLE_EQ(coarse->covered(), 0.5);
  EXPECT_DOUBLE_EQ(coarse->uncovered(later), 0.25);
  EXPECT_EQ(coarse->uncovered(mask), 0.0);
  EXPECT_EQ(coarse->uncovered(rt::MaskPyramidView{}), 0.0) << "without a mask nothing is known";
}

TEST(CoarseMask, NoMaskMasksNothing) {
  const auto coarse = std::make_unique<CoarseMask>();
  coarse->assign(rt::MaskPyramidView{});
  EXPECT_TRUE(coarse->empty());
  EXPECT_FALSE(coarse->masked(Vec2f(0.0f, 0.0f)));
}

}  // namespace coarse_mask_test
}  // namespace godwit::vo
