// The rules that LinkNode binds together, each for itself: health, pacing, silence, arming, words, what sending costs.
#include <algorithm>
#include <cstring>
#include <gtest/gtest.h>
#include <set>

#include "firmware_app/link/arming_watch.h"
#include "firmware_app/link/bus_account.h"
#include "firmware_app/link/bus_filters.h"
#include "firmware_app/link/condition.h"
#include "firmware_app/link/dronecan/types.h"
#include "firmware_app/link/pose_pacing.h"
#include "firmware_app/link/pose_watch.h"
#include "firmware_app/link/reset_counter.h"
#include "firmware_app/link/status_texts.h"
#include "tests/link/fake_bus.h"

namespace godwit::link {
namespace node_rules_test {

using dronecan::NodeHealth;
using dronecan::NodeMode;
constexpr rt::TimeNs kMs = rt::kNsPerMs;

Reasons only(Reason reason) {
  Reasons r;
  r.set(reason, true);
  return r;
}

TEST(Condition, EachReasonHasOneRowAndItsOwnBit) {
  std::set<int> bits;
  for (const ReasonRow& row : kReasonTable) {
    EXPECT_EQ(row.reason & (row.reason - 1), 0) << row.reason;
    EXPECT_TRUE(bits.insert(row.reason).second) << row.reason;
    EXPECT_EQ(condition(only(row.reason), {}).reasons, row.reason);
    EXPECT_EQ(condition(only(row.reason), {}).health, row.health) << row.reason;
  }
  EXPECT_EQ(*bits.rbegin(), kSameNodeId);
  EXPECT_EQ(bits.size(), 15u) << "bits 0 to 14 of docs/hazards.md";
}

TEST(Condition, WhatFailsIsAnErrorWhatIsPoorIsTold) {
  for (const Reason error : {kCameraFailed, kProcessFailed, kPoseStalled, kBadPose, kSameNodeId}) {
    EXPECT_EQ(condition(only(error), {}).health, NodeHealth::kError) << error;
    EXPECT_EQ(condition(only(error), {}).mode, NodeMode::kOperational) << "an error is told as such from the start on";
  }
  EXPECT_EQ(condition(only(kTooHot), {}).health, NodeHealth::kWarning);
  for (const Reason told : {kImuFailed, kNoPose, kNoScale, kNoGravity, kLatencyGrew, kBusTrouble, kNoAutopilot,
                            kNoTimesync, kDetectorFailed}) {
    EXPECT_EQ(condition(only(told), {}).health, NodeHealth::kOk) << told;
  }
  Reasons both = only(kTooHot);
  both.set(kCameraFailed, true);
  EXPECT_EQ(condition(both, {}).health, NodeHealth::kError) << "the worst counts";
  EXPECT_EQ(condition(both, {}).reasons, kTooHot | kCameraFailed);
}

TEST(Condition, WishesDecideOnSensorPoseAndMode) {
  EXPECT_EQ(condition(only(kImuFailed), {.imu_required = true}).health, NodeHealth::kError);
  EXPECT_EQ(condition({}, {.imu_required = true}).health, NodeHealth::kOk);
  EXPECT_EQ(condition(only(kNoPose), {.pose_wanted = true}).health, NodeHealth::kWarning);
  EXPECT_EQ(condition({}, {}).mode, NodeMode::kInitialization);
  EXPECT_EQ(condition({}, {.any_pose = true}).mode, NodeMode::kOperational);
}

TEST(PosePacing, ACameraOfTheSameRateLosesNoneAndAFasterOneIsThinned) {
  const rt::TimeNs period = 33 * kMs;
  for (const auto& [camera_ms, expected] : {std::pair{33, 100}, {11, 100}, {66, 50}}) {
    PosePacing pacing;
    int due = 0;
    for (rt::TimeNs t = 0; t < 3300 * kMs; t += camera_ms * kMs) {
      const rt::TimeNs jitter = (t / kMs * 7 % 11 - 5) * kMs / 2;
      due += pacing.due(rt::kNsPerSecond + t + (camera_ms == 33 ? jitter : 0), period) ? 1 : 0;
    }
    EXPECT_NEAR(due, expected, 1) << camera_ms;
  }
}

TEST(PosePacing, StampsGrowInTheMicrosecondsThatAreSent) {
  PosePacing pacing;
  pacing.begin(1000 * kMs);
  EXPECT_TRUE(pacing.far_enough(1000 * kMs));
  pacing.sent(990 * kMs, 1000 * kMs);
  EXPECT_FALSE(pacing.grows(990 * kMs));
  EXPECT_FALSE(pacing.grows(990 * kMs + 999)) << "the same microsecond";
  EXPECT_TRUE(pacing.grows(990 * kMs + 1000));
  EXPECT_FALSE(pacing.far_enough(1020 * kMs));
  EXPECT_TRUE(pacing.far_enough(1021 * kMs));
  // A word without a picture lies behind the last stamp, and before a pose that is up to a quarter of a second late.
  EXPECT_EQ(pacing.silence_stamp_ns(1080 * kMs), 991 * kMs);
  EXPECT_EQ(pacing.silence_stamp_ns(2000 * kMs), 1750 * kMs);
  EXPECT_FALSE(pacing.silence_due(1032 * kMs, 33 * kMs));
  EXPECT_TRUE(pacing.silence_due(1033 * kMs, 33 * kMs));
}

TEST(PoseWatch, SilenceIsDueByWhatIsBeingDone) {
  PoseWatch watch({});
  watch.begin(100 * kMs);
  EXPECT_EQ(watch.t_silence_ns(), 3100 * kMs) << "the first may take its time";
  watch.came(1000 * kMs);
  EXPECT_EQ(watch.t_silence_ns(), 1080 * kMs);
  watch.frame_begun(1035 * kMs);
  EXPECT_EQ(watch.t_silence_ns(), 1185 * kMs) << "its picture is there";
  watch.frame_begun(1090 * kMs);
  EXPECT_EQ(watch.t_silence_ns(), 1080 * kMs) << "too late to matter";
  EXPECT_TRUE(watch.stalled(1080 * kMs));
}

TEST(PoseWatch, APictureRepeatedIsNoSilence) {
  PoseWatch watch({});
  watch.begin(100 * kMs);
  watch.picture_repeated(110 * kMs);
  EXPECT_EQ(watch.t_silence_ns(), 3100 * kMs) << "before the first one there is nothing to repeat";
  watch.came(1000 * kMs);
  for (const int ms : {1033, 1066, 1100, 1133}) {
    watch.frame_begun(ms * kMs - 4 * kMs);
    EXPECT_FALSE(watch.stalled(ms * kMs)) << ms;
    watch.picture_repeated(ms * kMs);
  }
  EXPECT_EQ(watch.t_silence_ns(), 1213 * kMs) << "80 ms after the last of them";
  EXPECT_EQ(watch.repeated(), 5u);
}

TEST(ArmingWatch, TheNewestWordCountsAndSilenceChangesNothing) {
  ArmingWatch watch;
  EXPECT_FALSE(watch.armed(false, 0, 100 * kMs));
  EXPECT_TRUE(watch.armed(true, 50 * kMs, 100 * kMs));
  watch.heard_status(true, 1000 * kMs);
  EXPECT_TRUE(watch.armed(false, 1100 * kMs, 1200 * kMs)) << "they contradict each other for a moment";
  EXPECT_FALSE(watch.armed(false, 6500 * kMs, 6600 * kMs)) << "the older word is outdated";
  EXPECT_TRUE(watch.armed(true, 900 * kMs, 900'000 * kMs)) << "both said so and fell silent";
}

TEST(StatusTexts, EachChangeOnceAndNotTooOften) {
  StatusTexts texts;
  rt::TimeNs now = rt::kNsPerSecond;
  EXPECT_FALSE(texts.of_state(PoseState::kInitialising, false, false, now)) << "nothing to tell yet";
  auto line = texts.of_state(PoseState::kTracking, false, false, now);
  ASSERT_TRUE(line);
  EXPECT_EQ(line->view(), "VIO: tracking, no scale yet");
  EXPECT_EQ(line->severity, mavlink::StatusText::kWarning);
  EXPECT_FALSE(texts.of_state(PoseState::kTracking, true, false, now + 499 * kMs));
  line = texts.of_state(PoseState::kTracking, true, false, now + 500 * kMs);
  ASSERT_TRUE(line);
  EXPECT_EQ(line->view(), "VIO: tracking");
  EXPECT_EQ(line->severity, mavlink::StatusText::kInfo);
  EXPECT_FALSE(texts.of_state(PoseState::kTracking, true, false, now + 9000 * kMs));
  line = texts.of_state(PoseState::kLost, false, true, now + 9000 * kMs);
  ASSERT_TRUE(line);
  EXPECT_EQ(line->view(), "VIO: no picture, no pose");
}

TEST(StatusTexts, TheLatencyOnceAMinuteAndWhenItGrows) {
  StatusTexts texts;
  LatencySummary l;
  l.samples = LatencyMonitor::kMinSamples;
  l.p50_ms = 20;
  l.p99_ms = 31;
  l.viso_delay_ms = 12;
  const rt::TimeNs now = rt::kNsPerSecond;
  EXPECT_FALSE(texts.of_latency(l, false, now)) << "without TIMESYNC the way is not in it";
  const auto line = texts.of_latency(l, true, now);
  ASSERT_TRUE(line);
  EXPECT_EQ(line->view(), "VIO latency p50 20 p99 31 ms, VISO_DELAY_MS 12");
  EXPECT_FALSE(texts.of_latency(l, true, now + 59'000 * kMs));
  l.grew = true;
  const auto grew = texts.of_latency(l, true, now + 59'500 * kMs);
  ASSERT_TRUE(grew);
  EXPECT_EQ(grew->view(), "VIO LATENCY GREW p50 20 p99 31 VISO_DELAY_MS 12");
  EXPECT_EQ(grew->severity, mavlink::StatusText::kWarning);
  EXPECT_FALSE(texts.of_latency(l, true, now + 60'000 * kMs)) << "told";
  StatusTexts slow;
  l.p50_ms = l.p99_ms = 5000;
  l.viso_delay_ms = 250;
  EXPECT_EQ(slow.of_latency(l, true, now)->view(), "VIO LATENCY GREW p50 999 p99 999 VISO_DELAY_MS 250") << "never cut";
  EXPECT_TRUE(texts.of_latency(l, true, now + 120'000 * kMs));
}

// 217 bytes more than a TIMESYNC has, of 10 bits each, at 115200 bit/s: 18.8 ms that no clock of ours sees.
TEST(BusAccount, ASerialLinesWireTimeIsInTheLatency) {
  Wire line;
  line.synchronised = true;
  line.round_trip_ns = 8 * kMs;
  line.line_baud = 115200;
  const LatencyPath path = path_over(line);
  EXPECT_EQ(path.one_way_ns, 4 * kMs);
  EXPECT_NEAR(rt::to_ms(path.wire_extra_ns), 18.84, 0.01);
  EXPECT_EQ(path.serial_correction_ns, 0) << "the autopilot corrects only what comes through the tunnel";
  BusAccount account;
  for (int i = 0; i < 100; ++i) {
    account.given({i * 33 * kMs, i * 33 * kMs + 10 * kMs, 50, 0});
    ASSERT_TRUE(account.left());
    account.account(i * 33 * kMs + 11 * kMs, path);
  }
  const BusFigures& figures = account.each_second({}, 1e6, false);
  EXPECT_NEAR(figures.latency.p50_ms, 11 + 4 + 18.84, 0.01);
  EXPECT_EQ(figures.latency.viso_delay_ms, 34);
  EXPECT_NEAR(figures.own_p50_ms, 1, 1e-3);
}

TEST(BusAccount, TheTunnelsWireTimeAndTheAutopilotsCorrection) {
  Wire tunnel;
  tunnel.tunnel = true;
  tunnel.bus_bit_rate = 1e6;
  tunnel.pose_bits = 5540;
  tunnel.tunnel_baud = 921600;
  const LatencyPath path = path_over(tunnel);
  EXPECT_EQ(path.one_way_ns, 0) << "not known without TIMESYNC";
  EXPECT_NEAR(rt::to_ms(path.wire_extra_ns), 5.0, 1e-6);
  EXPECT_NEAR(rt::to_ms(path.serial_correction_ns), 2450 / 921.6, 1e-6);
}

TEST(BusAccount, APoseIsOutWithItsLastFrameAndWhatIsLostIsTrouble) {
  BusAccount account;
  EXPECT_FALSE(account.left(0));
  account.given({5 * kMs, 6 * kMs, -1, 7});
  EXPECT_FALSE(account.left(6));
  EXPECT_TRUE(account.left(7));
  EXPECT_FALSE(account.left(7)) << "once";
  const PoseDeparture departure = account.account(9 * kMs, {});
  EXPECT_EQ(departure.t_capture_ns, 5 * kMs);
  EXPECT_EQ(departure.t_sent_ns, 9 * kMs);
  account.given({50 * kMs, 0, -1, 8});
  ASSERT_TRUE(account.left(8));
  EXPECT_EQ(account.account(51 * kMs, {}).t_capture_ns, 0) << "of no frame";
  TxCounters tx;
  tx.bits = 250'000;
  const BusFigures& figures = account.each_second(tx, 1e6, false);
  EXPECT_EQ(figures.own_samples, 1u);
  EXPECT_EQ(figures.latency.samples, 0u) << "poses of quality -1 tell no latency";
  EXPECT_NEAR(figures.load_percent, 25, 1e-9);
  EXPECT_FALSE(figures.trouble);
  tx.poses_replaced = 1;
  EXPECT_TRUE(account.each_second(tx, 1e6, false).trouble);
  EXPECT_FALSE(account.each_second(tx, 1e6, false).trouble) << "of the last second only";
  EXPECT_TRUE(account.each_second(tx, 1e6, true).trouble);
  EXPECT_EQ(figures.load_percent, 0);
}

TEST(BusFilters, WhatNobodyReadsIsNotLetIn) {
  for (const bool inputs : {false, true}) {
    FakeBus bus;
    dronecan::Reassembler reassembler({dronecan::TunnelTargetted::kType});
    BusFilters filters(inputs);
    filters.follow(kTestNode, &bus, &reassembler);
    const auto let_in = [&](std::uint16_t type) {
      const std::uint32_t id = static_cast<std::uint32_t>(type) << 8 | kTestAutopilot;
      return std::any_of(bus.filters.begin(), bus.filters.end(),
                         [&](const hal::CanFilter& f) { return (id & f.mask) == (f.id & f.mask); });
    };
    for (const std::uint16_t sensor : {dronecan::RangeMeasurement::kType.id, dronecan::StaticPressure::kType.id,
                                       dronecan::RawImu::kType.id, dronecan::GlobalTimeSync::kType.id}) {
      EXPECT_EQ(let_in(sensor), inputs) << sensor;
    }
    EXPECT_TRUE(let_in(dronecan::TunnelTargetted::kType.id));
    EXPECT_TRUE(let_in(dronecan::ArmingStatus::kType.id));
  }
}

TEST(ResetCounter, IsReservedOnDiskAheadOfUse) {
  Storage storage("");
  ResetCounter counter(250);
  counter.reserve(&storage);
  storage.serve();
  StorageReply reply;
  EXPECT_TRUE(storage.reply(&reply)) << "asked for at the first step";
  counter.reserve(&storage);
  storage.serve();
  EXPECT_FALSE(storage.reply(&reply)) << "enough are left";
  counter.add(5);
  EXPECT_EQ(counter.value(), 255);
  counter.reserve(&storage);
  storage.serve();
  EXPECT_TRUE(storage.reply(&reply));
  counter.add(2);
  EXPECT_EQ(counter.value(), 1) << "it goes round";
}

}  // namespace node_rules_test
}  // namespace godwit::link
