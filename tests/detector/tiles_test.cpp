// Squares of a wide picture, and one list out of what was found in them.
#include "detector/tiles.h"

#include <gtest/gtest.h>
#include <utility>
#include <vector>

#include "detector/decode.h"

namespace godwit::detector::tiles_test {
namespace {

TEST(Tiles, AWidePictureIsCoveredBySquaresThatShareAQuarter) {
  const TileList tiles = square_tiles(1280, 720);
  ASSERT_EQ(tiles.count, 3);
  for (int i = 0; i < 3; ++i) {
    const Tile& t = tiles.tile[static_cast<std::size_t>(i)];
    EXPECT_EQ(t.left, 280 * i);
    EXPECT_EQ(t.top, 0);
    EXPECT_EQ(t.width, 720);
    EXPECT_EQ(t.height, 720);
  }
  const TileList upright = square_tiles(720, 1280);
  ASSERT_EQ(upright.count, 3);
  EXPECT_EQ(upright.tile[2].left, 0);
  EXPECT_EQ(upright.tile[2].top, 560);
}

TEST(Tiles, ANearlySquarePictureHasNone) {
  EXPECT_EQ(square_tiles(416, 416).count, 0);
  EXPECT_EQ(square_tiles(1, 1).count, 0);
  EXPECT_EQ(square_tiles(1280, 1024).count, 0);
  EXPECT_EQ(square_tiles(600, 481).count, 0);
  EXPECT_EQ(square_tiles(640, 480).count, 2);
}

TEST(Tiles, AnyPictureIsCovered) {
  for (const auto& [width, height] : {std::pair(640, 480), std::pair(1280, 312), std::pair(1280, 8), std::pair(7, 1000),
                                      std::pair(2, 1), std::pair(3, 2), std::pair(1280, 1)}) {
    const TileList tiles = square_tiles(width, height);
    ASSERT_GE(tiles.count, 2) << width << " x " << height;
    ASSERT_LE(tiles.count, kMaxTiles);
    const bool wide = width > height;
    const int longer = wide ? width : height;
    int reached = 0;
    for (const Tile& t : tiles.view()) {
      const int first = wide ? t.left : t.top, side = wide ? t.width : t.height;
      EXPECT_EQ(wide ? t.height : t.width, wide ? height : width);
      EXPECT_GE(first, 0);
      EXPECT_LE(first + side, longer);
      if (first > 0 && side > 3) {
        EXPECT_LE(first, reached - side / 4) << width << " x " << height;
      }
      EXPECT_LE(first, reached) << width << " x " << height << ": a gap";
      reached = first + side;
    }
    EXPECT_EQ(reached, longer);
  }
}

TEST(Tiles, ABoxIsWholeUnlessItReachesATilesEndInsideThePicture) {
  const Box middle = inner_part({280, 0, 720, 720}, 1280, 720);
  EXPECT_NEAR(middle.x0, 720.F / 33, 1e-3);
  EXPECT_NEAR(middle.x1, 720.F - 720.F / 33, 1e-3);
  EXPECT_LT(middle.y0, -1e9F) << "the picture's own edge";
  EXPECT_GT(middle.y1, 1e9F);
  const Box first = inner_part({0, 0, 720, 720}, 1280, 720), last = inner_part({560, 0, 720, 720}, 1280, 720);
  EXPECT_LT(first.x0, -1e9F);
  EXPECT_LT(first.x1, 720.F);
  EXPECT_GT(last.x0, 0.F);
  EXPECT_GT(last.x1, 1e9F);
  const Box upper = inner_part({0, 0, 480, 480}, 480, 640);
  EXPECT_LT(upper.y1, 480.F);
  EXPECT_GT(upper.x1, 1e9F);
}

TEST(Tiles, TheSurestOfTwoLooksAtAThingStays) {
  std::vector<Box> found = {{100, 100, 200, 200, 0.5F, 0},   // whole picture
                            {300, 100, 340, 140, 0.3F, 1},   // seen there only
                            {102, 100, 202, 200, 0.8F, 0},   // the same as the first, in a tile
                            {102, 100, 202, 200, 0.6F, 2}};  // of another class
  BoxList boxes;
  boxes.push({});
  merge(found, 0.45F, &boxes);
  ASSERT_EQ(boxes.count, 3);
  EXPECT_EQ(boxes.box[0].score, 0.8F);
  EXPECT_EQ(boxes.box[1].class_id, 2);
  EXPECT_EQ(boxes.box[2].class_id, 1);
}

TEST(Tiles, MoreThanAListHoldsLeavesTheSurest) {
  std::vector<Box> found;
  for (int i = 0; i < 3 * kMaxBoxes; ++i) {
    const auto x = static_cast<float>(10 * i);
    found.push_back({x, 0, x + 5, 5, 0.001F * static_cast<float>(i + 1), 0});
  }
  BoxList boxes;
  merge(found, 0.45F, &boxes);
  ASSERT_EQ(boxes.count, kMaxBoxes);
  EXPECT_EQ(boxes.box[0].x0, 10.F * (3 * kMaxBoxes - 1));
  EXPECT_GT(boxes.box[kMaxBoxes - 1].score, 0.001F * 2 * kMaxBoxes);
}

}  // namespace
}  // namespace godwit::detector::tiles_test
