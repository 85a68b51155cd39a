#include "firmware_app/output/event_causes.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace godwit::app {
namespace {

FrameRecord frame(vo::State state, std::uint32_t map = 1) {
  FrameRecord r;
  r.t_capture_ns = 7;
  r.state = state;
  r.map_id = map;
  return r;
}

TEST(EventCauses, BeginningIsNoEvent) {
  EventCauses causes;
  EXPECT_FALSE(causes.look(frame(vo::State::kInitialising, 0)));
  EXPECT_FALSE(causes.look(frame(vo::State::kTracking)));
  EXPECT_FALSE(causes.look(frame(vo::State::kTracking)));
}

TEST(EventCauses, LossIsToldOnceWithItsReason) {
  EventCauses causes;
  causes.look(frame(vo::State::kTracking));
  FrameRecord lost = frame(vo::State::kRelocalising);
  lost.reason.assign("too few features: 12 of 30");
  const auto cause = causes.look(lost);
  ASSERT_TRUE(cause);
  EXPECT_EQ(cause->kind, EventKind::kLoss);
  EXPECT_EQ(cause->t_ns, 7);
  EXPECT_EQ(cause->reason, "TRACKING -> RELOCALISING: too few features: 12 of 30");
  EXPECT_FALSE(causes.look(lost));
  EXPECT_FALSE(causes.look(frame(vo::State::kLost, 0)));
}

TEST(EventCauses, AnotherMapOrNavigationFrameIsAReset) {
  EventCauses causes;
  causes.look(frame(vo::State::kTracking, 1));
  causes.look(frame(vo::State::kLost, 0));
  const auto map = causes.look(frame(vo::State::kTracking, 2));
  ASSERT_TRUE(map);
  EXPECT_EQ(map->kind, EventKind::kReset);
  EXPECT_EQ(map->reason, "map 1 -> 2");
  FrameRecord metric = frame(vo::State::kTracking, 2);
  metric.metric = true;
  metric.frame_id = 1;
  EXPECT_FALSE(causes.look(metric)) << "the first frame is none";
  metric.frame_id = 2;
  const auto other = causes.look(metric);
  ASSERT_TRUE(other);
  EXPECT_EQ(other->kind, EventKind::kReset);
}

TEST(EventCauses, DoubtOfTheSelfCheckIsToldOnce) {
  EventCauses causes;
  FrameRecord r = frame(vo::State::kTracking);
  r.metric = true;
  r.frame_id = 1;
  EXPECT_FALSE(causes.look(r));
  r.trust = 0.5;
  const auto cause = causes.look(r);
  ASSERT_TRUE(cause);
  EXPECT_EQ(cause->kind, EventKind::kDoubt);
  EXPECT_THAT(cause->reason, testing::HasSubstr("trust 0.50, limit 0.55"));
  EXPECT_FALSE(causes.look(r));
  r.trust = 1;
  EXPECT_FALSE(causes.look(r));
  r.trust = 0.1;
  EXPECT_TRUE(causes.look(r));
}

TEST(EventCauses, WhatWasNotFlownSaysNothing) {
  EventCauses causes;
  causes.look(frame(vo::State::kTracking));
  FrameRecord dropped = frame(vo::State::kInitialising);
  dropped.fate = FrameFate::kDroppedLate;
  EXPECT_FALSE(causes.look(dropped));
  FrameRecord repeated = frame(vo::State::kRelocalising);
  repeated.repeated = true;
  EXPECT_FALSE(causes.look(repeated));
}

}  // namespace
}  // namespace godwit::app
