// Which points may speak for a pose between movers, and what becomes of a pose that none of them speak for: on rendered
// pictures with exact truth.
#include <cstddef>
#include <gtest/gtest.h>
#include <vector>

#include "tests/vo_core/crowd_flight.h"
#include "vo_core/tracking/tracker.h"

namespace godwit::vo {
namespace crowd_test {

/// Whatever hides, or does not, is a crowd; and no picture says as much as its points would be vouched for with.
TrackerOptions nothing_more_is_vouched_for() {
  TrackerOptions options;
  options.crowded = -1.0;
  options.most_evidence = 1e6;
  return options;
}

TEST(CrowdVouched, AMoverWhoIsFollowedIsLeftForTheMapThatIsSeenBesideHim) {
  // Away from where the map began, until too few of its first points are seen to tell a pose; then only the middle of
  // the picture goes on like that, and beside it is a place on the way.
  constexpr int kStep = 8, kAway = 70, kBack = kStep * 50, kRidden = 12;
  std::vector<Shot> order;
  order.reserve(kAway + kRidden);
  for (int i = 0; i < kAway; ++i) order.push_back({kStep * i});
  for (int i = 0; i < kRidden; ++i) {
    order.push_back({kBack});
    order.back().rider = kStep * (kAway + i);
  }
  const Flight flight = fly(order, nothing_more_is_vouched_for(), camera_of(640));
  ASSERT_FALSE(flight.frames[kAway - 1].tracked);
  ASSERT_STREQ(flight.frames[kAway - 1].reason, "too little speaks for the pose [nats]");
  const double scale = scale_of(flight, order, kAway);
  // As soon as another frame is searched for, or the one after, and one more to prove it.
  for (std::size_t i = kAway + 6; i < order.size(); ++i) {
    EXPECT_TRUE(flight.frames[i].tracked) << i << ": " << flight.frames[i].reason;
    EXPECT_EQ(flight.frames[i].map_id, flight.frames[kAway - 1].map_id) << i;
    EXPECT_LT(off_by(flight, order, i, scale), 0.05) << i;
  }
}

TEST(CrowdVouched, WhatNothingVouchedForIsNotToldWhenTheCrowdIsGone) {
  // Between movers away from where the map began, until too few of its first points are seen to tell a pose. Then the
  // movers are gone: what was mapped meanwhile agrees with itself, and proves no more than before. On the way back the
  // first points do.
  constexpr int kStep = 8, kAway = 70, kClear = 10;
  std::vector<Shot> order;
  order.reserve(2 * kAway);
  for (int i = 0; i < kAway; ++i) order.push_back({kStep * i, i < 20 ? 0.0 : 0.35});
  for (int i = kAway; i < kAway + kClear; ++i) order.push_back({kStep * i});
  for (int i = kAway + kClear - 2; i > 20; --i) order.push_back({kStep * i});
  TrackerOptions options = nothing_more_is_vouched_for();
  options.crowded = 0.2;
  const Flight flight = fly(order, options, camera_of(640));
  ASSERT_TRUE(flight.frames[30].tracked) << flight.frames[30].reason;
  for (std::size_t i = kAway - 1; i < kAway + kClear; ++i) {
    EXPECT_FALSE(flight.frames[i].tracked) << i;
    EXPECT_STREQ(flight.frames[i].reason, "too little speaks for the pose [nats]") << i;
  }
  EXPECT_TRUE(flight.frames.back().tracked) << flight.frames.back().reason;
  EXPECT_EQ(flight.frames.back().map_id, flight.frames[30].map_id);
}

TEST(CrowdVouched, PointsAreVouchedForOnlyByAPictureThatSpeaksForItsPoseAsAWhole) {
  const auto order = shots({{0, kFree + 9, 0.0}});
  const Flight flight = fly(order, nothing_more_is_vouched_for());
  TrackerOptions options;
  options.crowded = -1.0;
  const Flight usual = fly(order, options);
  std::size_t first = 0;
  while (first < order.size() && flight.points[first] == 0) ++first;
  ASSERT_LT(first, static_cast<std::size_t>(kFree));
  ASSERT_EQ(flight.vouched[first], flight.points[first]);
  for (std::size_t i = first; i < order.size(); ++i) {
    // The points of the map's beginning suffice to tell the pose.
    EXPECT_TRUE(flight.frames[i].tracked) << flight.frames[i].reason;
    EXPECT_LE(flight.vouched[i], flight.points[first]) << i;
  }
  EXPECT_GT(flight.points.back(), flight.points[first] + 30);
  EXPECT_GT(usual.vouched.back(), usual.points[first] + 30);
}

}  // namespace crowd_test
}  // namespace godwit::vo
