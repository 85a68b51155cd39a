#include "detector/box_mask.h"

#include <cmath>
#include <cstdint>
#include <gtest/gtest.h>
#include <limits>

namespace godwit::detector::box_mask_test {
namespace {

const std::vector<bool> kMovable = {true, false};

int count(const rt::ImageView& image) {
  int n = 0;
  for (int y = 0; y < image.height; ++y) {
    for (int x = 0; x < image.width; ++x) n += image.at(x, y) != 0 ? 1 : 0;
  }
  return n;
}

TEST(BoxMask, HasThePyramidsSizesAndAlignedRows) {
  const BoxMask mask(645, 483, 5);
  ASSERT_EQ(mask.view().levels, 5);
  for (int l = 0; l < 5; ++l) {
    const rt::ImageView& image = mask.view().level[static_cast<std::size_t>(l)];
    EXPECT_EQ(image.width, 645 >> l);
    EXPECT_EQ(image.height, 483 >> l);
    EXPECT_EQ(reinterpret_cast<std::uintptr_t>(image.data) % rt::kRowAlignment, 0U);
    EXPECT_EQ(image.stride % rt::kRowAlignment, 0);
    EXPECT_EQ(count(image), 0);
  }
}

TEST(BoxMask, MasksTheBoxAtEveryLevelByItsScale) {
  BoxMask mask(640, 480, 4, {0.F, 0.F, 0.F});
  const Box box{80.F, 40.F, 160.F, 120.F, 0.9F, 0};
  mask.update({&box, 1}, kMovable);
  for (int l = 0; l < 4; ++l) {
    const rt::ImageView& image = mask.view().level[static_cast<std::size_t>(l)];
    EXPECT_EQ(count(image), (80 >> l) * (80 >> l)) << "level " << l;
    EXPECT_EQ(image.at(80 >> l, 40 >> l), BoxMask::kDynamic);
    EXPECT_EQ(image.at((160 >> l) - 1, (120 >> l) - 1), BoxMask::kDynamic);
    EXPECT_EQ(image.at((80 >> l) - 1, 40 >> l), 0);
    EXPECT_EQ(image.at(160 >> l, 119 >> l), 0);
  }
}

TEST(BoxMask, WidensByTheMargin) {
  BoxMask mask(640, 480, 1, {0.1F, 3.F, 1.F});
  const Box box{100.F, 100.F, 200.F, 300.F, 0.9F, 0};
  mask.update({&box, 1}, kMovable);
  const rt::ImageView& image = mask.view().level[0];
  // 10 % of 100 + 3 + 1 on the left, 10 % of 200 + 3 + 1 above.
  EXPECT_EQ(image.at(86, 200), BoxMask::kDynamic);
  EXPECT_EQ(image.at(85, 200), 0);
  EXPECT_EQ(image.at(150, 76), BoxMask::kDynamic);
  EXPECT_EQ(image.at(150, 75), 0);
}

TEST(BoxMask, OnlyWhatMayMoveIsMasked) {
  BoxMask mask(64, 64, 1);
  Box box{10.F, 10.F, 20.F, 20.F, 0.9F, 1};
  mask.update({&box, 1}, kMovable);
  EXPECT_EQ(count(mask.view().level[0]), 0);
  box.class_id = 7;  // unknown to the metadata: not trusted
  mask.update({&box, 1}, kMovable);
  EXPECT_GT(count(mask.view().level[0]), 0);
}

TEST(BoxMask, EachUpdateStartsAfresh) {
  BoxMask mask(64, 64, 3);
  const Box box{10.F, 10.F, 20.F, 20.F, 0.9F, 0};
  mask.update({&box, 1}, kMovable);
  mask.update({}, kMovable);
  for (int l = 0; l < 3; ++l) EXPECT_EQ(count(mask.view().level[static_cast<std::size_t>(l)]), 0);
}

TEST(BoxMask, AbsurdBoxesAreSkippedOrClipped) {
  BoxMask mask(640, 480, 5);
  const float nan = std::numeric_limits<float>::quiet_NaN(), inf = std::numeric_limits<float>::infinity();
  const Box bad[] = {{nan, 0, 10, 10, 1, 0}, {0, 0, inf, 10, 1, 0}, {20, 20, 10, 30, 1, 0}, {5, 5, 5, 5, 1, 0}};
  mask.update(bad, kMovable);
  for (int l = 0; l < 5; ++l) EXPECT_EQ(count(mask.view().level[static_cast<std::size_t>(l)]), 0);
  const Box whole{-1e30F, -1e30F, 1e30F, 1e30F, 1, 0};
  mask.update({&whole, 1}, kMovable);
  for (int l = 0; l < 5; ++l) {
    const rt::ImageView& image = mask.view().level[static_cast<std::size_t>(l)];
    EXPECT_EQ(count(image), image.width * image.height);
  }
}

TEST(BoxMask, TenThousandBoxes) {
  BoxMask mask(320, 240, 5);
  std::vector<Box> boxes(10'000, Box{100.F, 100.F, 110.F, 110.F, 0.5F, 0});
  mask.update(boxes, kMovable);
  EXPECT_EQ(mask.view().level[0].at(105, 105), BoxMask::kDynamic);
  EXPECT_EQ(mask.view().level[0].at(50, 105), 0);
}

}  // namespace
}  // namespace godwit::detector::box_mask_test
