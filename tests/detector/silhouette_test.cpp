#include "detector/silhouette.h"

#include <gtest/gtest.h>
#include <limits>
#include <vector>

namespace godwit::detector {
namespace {

constexpr int kSide = 52;

ModelInfo model() {
  ModelInfo info;
  info.input_width = info.input_height = 416;
  info.classes = {"person", "car"};
  info.movable = {true, true};
  info.silhouette = {true, false};
  return info;
}

/// A 640 x 480 picture in 416 x 416: 52 rows of border above and below.
struct Scene {
  ModelInfo info = model();
  LetterboxFit fit = fit_letterbox(info, 640, 480);
  std::vector<float> value = std::vector<float>(kSide * kSide, 0.F);

  /// Sets what lies in the rectangle, in pixels of the picture.
  void set(float x0, float y0, float x1, float y1, float v) {
    for (int y = 0; y < kSide; ++y) {
      for (int x = 0; x < kSide; ++x) {
        const float px = ((static_cast<float>(x) + 0.5F) * 8.F - static_cast<float>(fit.left)) / fit.scale;
        const float py = ((static_cast<float>(y) + 0.5F) * 8.F - static_cast<float>(fit.top)) / fit.scale;
        if (px >= x0 && px < x1 && py >= y0 && py < y1) value[static_cast<std::size_t>(y * kSide + x)] = v;
      }
    }
  }
  Box shaped(Box box) const {
    shape_boxes({value, kSide, kSide}, info, fit, {}, {&box, 1});
    return box;
  }
};

const Box kPerson{100.F, 50.F, 420.F, 370.F, 0.9F, 0};

TEST(Silhouette, CellsAreCoveredWhereTheMapSaysSo) {
  Scene scene;
  scene.set(100.F, 50.F, 260.F, 370.F, 0.9F);  // the left half of the box
  const Box box = scene.shaped(kPerson);
  ASSERT_FALSE(box.shape.whole());
  for (int y = 0; y < BoxShape::kCells; ++y) {
    for (int x = 0; x < BoxShape::kCells; ++x) {
      // A cell of the map is 12.3 pixels of the picture, one of the shape 10.
      if (x < 14 || x > 17) {
        EXPECT_EQ(box.shape.covers(x, y), x < 14) << x << ' ' << y;
      }
    }
  }
}

TEST(Silhouette, HolesAreFilledAndBaysAreNot) {
  Scene scene;
  scene.set(100.F, 50.F, 420.F, 370.F, 0.9F);
  scene.set(200.F, 150.F, 300.F, 250.F, 0.F);  // a hole
  scene.set(200.F, 300.F, 300.F, 370.F, 0.F);  // a bay, open below
  const Box box = scene.shaped(kPerson);
  EXPECT_TRUE(box.shape.covers(15, 15));
  EXPECT_FALSE(box.shape.covers(15, 30));
}

TEST(Silhouette, OnlyClassesThatHaveOneGetAShape) {
  Scene scene;
  scene.set(100.F, 50.F, 260.F, 370.F, 0.9F);
  Box car = kPerson, unknown = kPerson, none = kPerson;
  car.class_id = 1;
  unknown.class_id = 2;
  none.class_id = -1;
  EXPECT_TRUE(scene.shaped(car).shape.whole());
  EXPECT_TRUE(scene.shaped(unknown).shape.whole());
  EXPECT_TRUE(scene.shaped(none).shape.whole());
}

TEST(Silhouette, OneThatFillsNextToNothingOfItsBoxIsNotBelieved) {
  Scene scene;
  scene.set(100.F, 50.F, 130.F, 80.F, 0.9F);
  EXPECT_TRUE(scene.shaped(kPerson).shape.whole());
}

TEST(Silhouette, WhatIsNoNumberCountsAsCovered) {
  Scene scene;
  scene.set(100.F, 50.F, 260.F, 370.F, std::numeric_limits<float>::quiet_NaN());
  const Box box = scene.shaped(kPerson);
  EXPECT_TRUE(box.shape.covers(5, 5));
  EXPECT_FALSE(box.shape.covers(25, 5));
}

TEST(Silhouette, AMapOfAnotherSizeChangesNothing) {
  Scene scene;
  scene.set(100.F, 50.F, 260.F, 370.F, 0.9F);
  Box box = kPerson;
  shape_boxes({scene.value, kSide, kSide - 1}, scene.info, scene.fit, {}, {&box, 1});
  shape_boxes({{}, 0, 0}, scene.info, scene.fit, {}, {&box, 1});
  EXPECT_TRUE(box.shape.whole());
}

TEST(Silhouette, BoxesAtAndBeyondTheEdgeStayInsideTheMap) {
  Scene scene;
  scene.set(0.F, 0.F, 320.F, 480.F, 0.9F);
  for (const Box& box :
       {Box{0.F, 0.F, 640.F, 480.F, 1.F, 0}, Box{-1e6F, -1e6F, 1e6F, 1e6F, 1.F, 0}, Box{0.F, 0.F, 0.5F, 0.5F, 1.F, 0}})
    EXPECT_TRUE(scene.shaped(box).shape.covers(0, 31));
  EXPECT_TRUE(scene.shaped(Box{630.F, 470.F, 640.F, 480.F, 1.F, 0}).shape.whole()) << "nothing of it is seen";
}

Box left_half() {
  Box box{100.F, 100.F, 200.F, 200.F, 1.F, 0};
  box.shape.row.fill(0x0000ffffU);
  return box;
}

TEST(Silhouette, OverAWiderBoxTheShapeStaysWhereItWas) {
  const Box box = left_half();
  Box wider = box;
  wider.x0 = 0.F;  // twice as wide
  for (std::size_t y = 0; y < BoxShape::kCells; ++y) {
    EXPECT_EQ(shape_over(box, wider, 0.F, 0.F, Outside::kCovered).row[y], 0x00ffffffU);
    EXPECT_EQ(shape_over(box, wider, 0.F, 0.F, Outside::kFree).row[y], 0x00ff0000U);
  }
  EXPECT_EQ(shape_over(box, box, 0.F, 0.F, Outside::kCovered), box.shape);
  EXPECT_EQ(shape_over(box, box, 0.F, 0.F, Outside::kFree), box.shape);
  EXPECT_TRUE(shape_over({100.F, 100.F, 200.F, 200.F, 1.F, 0}, wider, 0.F, 0.F, Outside::kCovered).whole());
}

TEST(Silhouette, OverAPartOfTheBoxOnlyThatPartOfTheShapeCounts) {
  const Box box = left_half();
  Box part = box;
  part.x0 = 150.F;
  EXPECT_EQ(shape_over(box, part, 0.F, 0.F, Outside::kCovered).row[7], 0U);
  part.x0 = 125.F;
  EXPECT_EQ(shape_over(box, part, 0.F, 0.F, Outside::kFree).row[7], 0x000007ffU) << "25 of 75 pixels";
}

TEST(Silhouette, ALimbOfOneCellIsNotLostInAWiderBox) {
  Box box{100.F, 100.F, 132.F, 132.F, 1.F, 0};
  Box wider{100.F, 100.F, 196.F, 196.F, 1.F, 0};
  for (int x = 0; x < BoxShape::kCells; ++x) {
    box.shape.row.fill(0);
    box.shape.row[9] = std::uint32_t{1} << x;
    const BoxShape shape = shape_over(box, wider, 0.F, 0.F, Outside::kFree);
    EXPECT_TRUE(shape.covers(x / 3, 3)) << x;
  }
}

TEST(Silhouette, ReachWidensTheShapeInwards) {
  const Box box = left_half();
  const BoxShape shape = shape_over(box, box, 5.F, 0.F, Outside::kFree);  // 1.6 cells
  EXPECT_EQ(shape.row[0], 0x0003ffffU);
}

}  // namespace
}  // namespace godwit::detector
