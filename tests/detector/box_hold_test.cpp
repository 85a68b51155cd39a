#include "detector/box_hold.h"

#include <gtest/gtest.h>
#include <utility>

#include "detector/box_carrier.h"

namespace godwit::detector::box_hold_test {
namespace {

constexpr int kPerson = 0, kCar = 2;
constexpr std::int64_t kApart = 100'000'000;
/// Cut off by the left edge.
const Box kThere{0.F, 100.F, 200.F, 300.F, 0.8F, kPerson};

HoldLimits limits() {
  HoldLimits out;
  out.width = 640;
  return out;
}

BoxList list(std::initializer_list<Box> boxes) {
  BoxList out;
  for (const Box& b : boxes) out.push(b);
  return out;
}
Box unsure(Box b) {
  b.score = 0.1F;
  return b;
}

TEST(BoxHold, AnUnsureBoxCountsOnlyWhereItsThingWas) {
  BoxList found =
      list({unsure({5.F, 110.F, 205.F, 300.F, 0.F, kPerson}), unsure({400.F, 100.F, 500.F, 300.F, 0.F, 0})});
  hold({&kThere, 1}, kApart, limits(), &found);
  ASSERT_EQ(found.count, 1);
  EXPECT_EQ(found.box[0].x0, 5.F) << "where it is now, not where it was";
  EXPECT_EQ(found.box[0].missed, 0);

  found = list({unsure(kThere)});
  hold({}, kApart, limits(), &found);
  EXPECT_EQ(found.count, 0) << "nothing was there";
  found = list({unsure({5.F, 110.F, 205.F, 300.F, 0.F, kCar})});
  hold({&kThere, 1}, kApart, limits(), &found);
  ASSERT_EQ(found.count, 1);
  EXPECT_EQ(found.box[0].class_id, kPerson) << "an unsure car is no sign of the person that was there";
  EXPECT_EQ(found.box[0].missed, 1);
}

TEST(BoxHold, AnUnsureBoxDoesNotDoubleWhatIsSurelyFound) {
  BoxList found = list({kThere, unsure({20.F, 120.F, 230.F, 310.F, 0.F, kPerson})});
  hold({&kThere, 1}, kApart, limits(), &found);
  ASSERT_EQ(found.count, 1);
  EXPECT_EQ(found.box[0].score, 0.8F);
}

TEST(BoxHold, WhatIsMissedStaysForTwoDetectionsAndNoMore) {
  BoxList held = list({kThere});
  for (const int expected : {1, 1, 0}) {
    BoxList found;
    hold(held.view(), kApart, limits(), &found);
    EXPECT_EQ(found.count, expected);
    held = found;
  }
}

TEST(BoxHold, NothingIsHeldForLongerThanASecondHoweverRareDetectionsAre) {
  for (const auto& [apart_ms, expected] : {std::pair{400, 2}, {500, 2}, {600, 1}, {1000, 1}, {1100, 0}}) {
    BoxList held = list({kThere});
    int times = 0;
    for (; times < 5 && held.count > 0; ++times) {
      BoxList found;
      hold(held.view(), apart_ms * std::int64_t{1'000'000}, limits(), &found);
      held = found;
    }
    EXPECT_EQ(times - 1, expected) << apart_ms;
  }
}

TEST(BoxHold, WhatIsWholeIsNotHeld) {
  for (const auto& [box, expected] : {std::pair{Box{1.F, 1.F, 200.F, 300.F, 0.8F, kPerson}, 0},
                                      {{1.F, 0.F, 200.F, 300.F, 0.8F, kPerson}, 1},
                                      {{500.F, 1.F, 640.F, 300.F, 0.8F, kPerson}, 1}}) {
    BoxList found;
    hold({&box, 1}, kApart, limits(), &found);
    EXPECT_EQ(found.count, expected);
    found = list({unsure(box)});
    hold({&box, 1}, kApart, limits(), &found);
    EXPECT_EQ(found.count, expected);
  }
}

TEST(BoxHold, WhatIsFoundAgainMayBeMissedAgain) {
  Box missed = kThere;
  missed.missed = 2;
  BoxList found = list({kThere});
  hold({&missed, 1}, kApart, limits(), &found);
  ASSERT_EQ(found.count, 1);
  EXPECT_EQ(found.box[0].missed, 0);
}

TEST(BoxHold, WhatALargerBoxCoversIsNotHeldBesideIt) {
  BoxList found = list({{0.F, 50.F, 400.F, 400.F, 0.9F, kPerson}});
  hold({&kThere, 1}, kApart, limits(), &found);
  EXPECT_EQ(found.count, 1);
}

TEST(BoxHold, AFullListLeavesOutWhatIsHeldFirst) {
  BoxList found;
  for (int i = 0; i < kMaxBoxes; ++i) {
    const float x = 300.F + static_cast<float>(i);
    found.push({x, 400.F, x + 1.F, 401.F, 0.9F, kPerson});
  }
  hold({&kThere, 1}, kApart, limits(), &found);
  ASSERT_EQ(found.count, kMaxBoxes);
  for (const Box& b : found.view()) EXPECT_EQ(b.missed, 0);
}

TEST(BoxHold, WhatIsHeldGoesOnWithItsMotion) {
  CarrierLimits no_growth;
  no_growth.growth_per_s = 0.F;
  BoxCarrier carrier(640, 480, no_growth);
  CameraMotion pan;
  pan.far_homography[2] = -10.F;
  carrier.advance(1, {}, pan);
  carrier.replace(1, {&kThere, 1});
  carrier.advance(2, {}, pan);
  std::span<const Box> before;
  ASSERT_TRUE(carrier.boxes_at(2, &before));
  BoxList found;
  hold(before, kApart, limits(), &found);
  ASSERT_TRUE(carrier.replace(2, found.view()));
  carrier.advance(3, {}, pan);
  ASSERT_EQ(carrier.boxes().size(), 1U);
  EXPECT_EQ(carrier.boxes()[0].x0, 0.F);
  EXPECT_NEAR(carrier.boxes()[0].x1, 180.F, 1e-3);
}

}  // namespace
}  // namespace godwit::detector::box_hold_test
