// The link's small parts: queues, bits on the wire, MAVLink parsing, inputs.
#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <string>
#include <vector>

#include "firmware_app/link/byte_port.h"
#include "firmware_app/link/dronecan/types.h"
#include "firmware_app/link/frame_bits.h"
#include "tests/link/fake_bus.h"
#include "tests/link/hex.h"

namespace godwit::link {
namespace parts_test {

TEST(TxQueue, TransferIdsLeaveNoGapsWhenMessagesAreDropped) {
  TxQueue queue;
  FakeBus bus;
  bus.budget = 0;
  std::uint8_t id = 31;
  const std::array<std::uint8_t, 20> payload{};
  const auto add = [&](TxClass tx_class) {
    ASSERT_TRUE(queue.begin(tx_class, 0));
    queue.add({.type_id = 3001, .source = 42, .payload = payload}, 0, &id);
    queue.add({.type_id = 3001, .source = 42, .payload = payload}, 0, &id);
    EXPECT_NE(queue.commit(), 0U);
  };
  for (int i = 0; i < 5; ++i) {
    add(TxClass::kPose);
    queue.drain(bus, 0, 100);
  }
  EXPECT_EQ(queue.counters().poses_replaced, 4U);
  bus.budget = 2;  // begins the newest
  queue.drain(bus, 0, 100);
  bus.budget = 0;
  add(TxClass::kPose);
  EXPECT_EQ(queue.counters().poses_replaced, 4U) << "a message that began is finished";
  bus.budget = SIZE_MAX;
  queue.drain(bus, 0, 100);
  std::vector<int> ids;
  for (const auto& [t, f] : bus.sent) {
    if ((f.data[f.length - 1U] & 0x80U) != 0) ids.push_back(f.data[f.length - 1U] & 0x1F);
  }
  EXPECT_EQ(ids, (std::vector<int>{31, 0, 1, 2}));
  EXPECT_TRUE(queue.empty());
}

TEST(TxQueue, FlightGoesBeforeServiceAndKeepsRoom) {
  TxQueue queue;
  FakeBus bus;
  hal::CanFrame frame;
  frame.extended = false;
  frame.length = 1;
  int services = 0;
  while (queue.begin(TxClass::kService, 0)) {
    frame.id = 1;
    queue.add_raw(frame);
    queue.commit();
    ++services;
  }
  EXPECT_EQ(services, 16);
  ASSERT_TRUE(queue.begin(TxClass::kFlight, 0));
  frame.id = 2;
  queue.add_raw(frame);
  queue.commit();
  queue.drain(bus, 0, 100);
  EXPECT_EQ(bus.sent.front().second.id, 2U);
  EXPECT_EQ(bus.sent.size(), 17U);
  ASSERT_TRUE(queue.begin(TxClass::kFlight, 0));
  EXPECT_EQ(queue.commit(), 0U) << "an empty message is none";
}

TEST(ByteQueue, FinishesWhatBeganAndReplacesWaitingPoses) {
  ByteQueue queue;
  const std::vector<std::uint8_t> one(100, 1), two(50, 2), three(60, 3), status(10, 4);
  EXPECT_TRUE(queue.push(one, TxClass::kPose));
  queue.consume(30);
  EXPECT_TRUE(queue.push(status, TxClass::kFlight));
  EXPECT_TRUE(queue.push(two, TxClass::kPose));
  EXPECT_TRUE(queue.push(three, TxClass::kPose));
  EXPECT_EQ(queue.poses_replaced(), 1U);
  std::vector<std::uint8_t> out;
  while (!queue.front().empty()) {
    const std::size_t take = std::min<std::size_t>(7, queue.front().size());
    out.insert(out.end(), queue.front().begin(), queue.front().begin() + static_cast<std::ptrdiff_t>(take));
    queue.consume(take);
  }
  std::string expected;
  for (int i = 0; i < 70; ++i) expected += "01";
  EXPECT_EQ(to_hex(out), expected + to_hex(status) + to_hex(three));
  int fit = 0;
  while (queue.push(status, TxClass::kFlight)) ++fit;
  EXPECT_EQ(fit, 16);
  EXPECT_FALSE(queue.push(std::vector<std::uint8_t>(301), TxClass::kFlight));
}

TEST(FrameBits, KnownFrames) {
  hal::CanFrame f;
  f.extended = false;
  f.id = 0x555;  // alternating bits
  f.length = 0;
  const double bits = frame_bits(f);
  EXPECT_GE(bits, 47);
  EXPECT_LE(bits, 52);
  f.id = 0;  // start, id, flags, length and CRC are all zeros, and each five of them get a stuff bit
  EXPECT_EQ(frame_bits(f), 47 + (1 + 11 + 3 + 4 + 15) / 5);
  f.extended = true;
  f.length = 8;
  for (auto& b : f.data) b = 0x55;
  f.id = 0x15555555;
  EXPECT_GE(frame_bits(f), 131);
  EXPECT_LE(frame_bits(f), 131 + 29);
  f.fd = true;
  f.length = 64;
  EXPECT_LT(frame_bits(f, 4), frame_bits(f, 1) / 2);
}

TEST(MavlinkParser, FindsMessagesInNoiseAndCountsWhatItPassesOver) {
  mavlink::Sender sender{1, 1, 0};
  mavlink::MessageBytes bytes;
  mavlink::Heartbeat heartbeat;
  heartbeat.custom_mode = 77;
  const std::size_t size = mavlink::encode(heartbeat, &sender, &bytes);
  std::vector<std::uint8_t> stream{0x00, 0xFD, 0x09, 0xFE};
  const auto add = [&](std::size_t flip) {
    const std::size_t at = stream.size();
    stream.insert(stream.end(), bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(size));
    if (flip < size) stream[at + flip] ^= 0x10;
  };
  for (std::size_t flip = 0; flip < size; ++flip) {
    add(flip);
    add(999);
  }
  for (int i = 0; i < 15; ++i) add(999);  // pushes out what a damaged length may still wait for
  for (const std::size_t step : {std::size_t{1}, std::size_t{7}, stream.size()}) {
    mavlink::Parser parser;
    std::size_t good = 0;
    for (std::size_t at = 0; at < stream.size(); at += step) {
      parser.feed(std::span(stream).subspan(at, std::min(step, stream.size() - at)),
                  [&](const mavlink::RawMessage& raw) {
                    mavlink::Heartbeat back;
                    mavlink::decode(raw, &back);
                    EXPECT_EQ(back.custom_mode, 77U);
                    ++good;
                  });
    }
    // A flipped id makes a message we do not know, which is passed over whole.
    EXPECT_GE(good, size + 10) << step;
    EXPECT_LE(good, size + 15);
    EXPECT_GT(parser.counters().bad_crc, 10U);
    EXPECT_GT(parser.counters().unknown, 0U);
    EXPECT_GT(parser.counters().incompatible, 0U);
  }
}

TEST(Inputs, AReaderThatWasAwayHearsWhatComesNowNotWhatWas) {
  const auto ring = std::make_unique<InputRing>();
  AutopilotInput input;
  for (std::size_t i = 0; i < 2 * InputRing::capacity(); ++i) {
    input.t_arrival_ns = static_cast<rt::TimeNs>(i);
    ring->try_push(input);
  }
  EXPECT_FALSE(take_input(ring.get(), &input)) << "512 that are old";
  input.t_arrival_ns = 4000;
  ASSERT_TRUE(ring->try_push(input));
  ASSERT_TRUE(take_input(ring.get(), &input));
  EXPECT_EQ(input.t_arrival_ns, 4000);
  EXPECT_FALSE(take_input(ring.get(), &input));
}

/// The message over the line; false where nothing is made of it.
template <typename Message>
bool from_mavlink(const Message& message, AutopilotInput* input) {
  mavlink::Sender sender{1, 1, 0};
  mavlink::MessageBytes bytes;
  mavlink::Parser parser;
  bool taken = false;
  const std::size_t size = mavlink::encode(message, &sender, &bytes);
  parser.feed({bytes.data(), size}, [&](const mavlink::RawMessage& raw) { taken = input_from_mavlink(raw, input); });
  return taken;
}

TEST(Inputs, AreScaledAndNonsenseIsRefused) {
  AutopilotInput input;
  const auto give = [&](const auto& message) { return from_mavlink(message, &input); };
  mavlink::RawImu imu;
  imu.time_usec = 12345;
  imu.zacc = -1000;
  imu.xgyro = 500;
  ASSERT_TRUE(give(imu));
  EXPECT_EQ(input.kind, InputKind::kImu);
  EXPECT_NEAR(input.value[2], -9.80665, 1e-9);
  EXPECT_NEAR(input.value[3], 0.5, 1e-9);
  EXPECT_EQ(input.t_source_us, 12345U);
  mavlink::HighresImu high;
  EXPECT_FALSE(give(high)) << "no fields updated";
  high.fields_updated = 0x3F;
  high.yacc = std::nanf("");
  EXPECT_FALSE(give(high));
  mavlink::DistanceSensor range;
  range.min_distance = 20;
  range.max_distance = 4000;
  range.current_distance = 153;
  range.orientation = 25;
  ASSERT_TRUE(give(range));
  EXPECT_NEAR(input.value[0], 1.53, 1e-9);
  range.current_distance = 4001;
  EXPECT_FALSE(give(range)) << "out of its reach";
  mavlink::AttitudeQuaternion attitude;
  EXPECT_FALSE(give(attitude)) << "no rotation";
  mavlink::GlobalPositionInt global;
  global.lat = 473977000;
  global.lon = -85456000;
  global.alt = 488123;
  ASSERT_TRUE(give(global));
  EXPECT_NEAR(input.value[0], 47.3977, 1e-9);
  EXPECT_NEAR(input.value[1], -8.5456, 1e-9);
  EXPECT_NEAR(input.value[2], 488.123, 1e-9);
  global.lat = 1000000000;
  EXPECT_FALSE(give(global));

  std::array<std::uint8_t, dronecan::kMaxPayload> payload;
  const auto give_can = [&](const auto& message) {
    using T = std::decay_t<decltype(message)>;
    dronecan::Transfer t{
        .type_id = T::kType.id, .source = 9, .payload = {payload.data(), dronecan::encode(message, payload, false)}};
    return input_from_dronecan(t, &input);
  };
  dronecan::RangeMeasurement can_range;
  can_range.range_m = 12.5F;
  EXPECT_FALSE(give_can(can_range)) << "reading type undefined";
  can_range.reading_type = 1;
  can_range.sensor_id = 3;
  ASSERT_TRUE(give_can(can_range));
  EXPECT_EQ(input.value[0], 12.5);
  EXPECT_EQ(input.sensor, 3);
  EXPECT_EQ(input.source, 9);
  dronecan::StaticPressure pressure;
  EXPECT_FALSE(give_can(pressure));
  pressure.pressure_pa = 95000;
  pressure.variance_pa2 = std::nanf("");
  EXPECT_FALSE(give_can(pressure));
  pressure.variance_pa2 = 4;
  EXPECT_TRUE(give_can(pressure));
  can_range.orientation_defined = true;
  can_range.roll_pitch_yaw = {0, -6, 0};
  ASSERT_TRUE(give_can(can_range));
  EXPECT_EQ(input.value[1], kLooksDown);
  can_range.roll_pitch_yaw = {0, 0, 6};
  ASSERT_TRUE(give_can(can_range));
  EXPECT_EQ(input.value[1], kLooksElsewhere);
  dronecan::GlobalTimeSync time;
  time.previous_transmission_us = 55;
  ASSERT_TRUE(give_can(time));
  EXPECT_EQ(input.t_source_us, 55U);
}

TEST(Inputs, PressureAndSatellitesAreThoseOfTheSensors) {
  AutopilotInput input;
  const auto give = [&](const auto& message) { return from_mavlink(message, &input); };
  mavlink::ScaledPressure pressure;
  EXPECT_FALSE(give(pressure));
  pressure.time_boot_ms = 7;
  pressure.press_abs = 950.5F;
  ASSERT_TRUE(give(pressure));
  EXPECT_EQ(input.kind, InputKind::kPressure);
  EXPECT_TRUE(input.from_autopilot);
  EXPECT_EQ(input.value[0], 95050);
  EXPECT_EQ(input.t_source_us, 7000U);
  mavlink::GpsRawInt fix;
  fix.lat = 473977000;
  fix.lon = -85456000;
  fix.alt = 488123;
  fix.fix_type = 3;
  fix.h_acc = 800;
  fix.v_acc = 1200;
  fix.vel = 500;
  fix.cog = 9000;
  fix.time_usec = 12345;
  ASSERT_TRUE(give(fix));
  EXPECT_EQ(input.kind, InputKind::kSatellites);
  EXPECT_EQ(input.t_source_us, 12345U);
  EXPECT_NEAR(input.value[0], 47.3977, 1e-9);
  EXPECT_NEAR(input.value[2], 488.123, 1e-9);
  EXPECT_EQ(input.value[3], kFix3d);
  EXPECT_NEAR(input.value[4], 0.8, 1e-9);
  EXPECT_NEAR(input.value[5], 1.2, 1e-9);
  EXPECT_EQ(input.value[8], 0) << "who does not say how sure his velocity is tells none";
  fix.vel_acc = 70;
  ASSERT_TRUE(give(fix));
  EXPECT_NEAR(input.value[6], 5, 1e-9) << "eastwards";
  EXPECT_NEAR(input.value[7], 0, 1e-9);
  EXPECT_NEAR(input.value[8], 0.07, 1e-9);
  fix.cog = 65535;
  ASSERT_TRUE(give(fix));
  EXPECT_EQ(input.value[8], 0) << "a course that is not known";
  fix.time_usec = 1'700'000'000'000'000;
  ASSERT_TRUE(give(fix));
  EXPECT_EQ(input.t_source_us, 0U) << "a date is no time since boot";

  // A Fix2 as pydronecan packs it, for classic CAN.
  const std::vector<std::uint8_t> packed = from_hex(
      "0706050403020100000000000000000000018def32035ecbe72fb1f3fffddb90380000c03f000020c00000803e47108600340038003c1f21"
      "1f211f29003e");
  const dronecan::Transfer transfer{.type_id = dronecan::GnssFix2::kType.id, .source = 9, .payload = packed};
  ASSERT_TRUE(input_from_dronecan(transfer, &input));
  EXPECT_EQ(input.kind, InputKind::kSatellites);
  EXPECT_FALSE(input.from_autopilot);
  EXPECT_NEAR(input.value[0], -47.39770005, 1e-9);
  EXPECT_NEAR(input.value[1], 8.54560001, 1e-9);
  EXPECT_NEAR(input.value[2], 488.123, 1e-9);
  EXPECT_EQ(input.value[3], kFix3d);
  EXPECT_NEAR(input.value[4], std::sqrt(0.5), 1e-6);
  EXPECT_NEAR(input.value[5], 1, 1e-6);
  EXPECT_NEAR(input.value[6], -2.5, 1e-6) << "eastwards";
  EXPECT_NEAR(input.value[7], 1.5, 1e-6);
  EXPECT_GT(input.value[8], 0);
  // Half precision's infinity for the velocity's variances: the place counts all the same.
  std::vector<std::uint8_t> unsure = packed;
  for (std::size_t i = 0; i + 1 < unsure.size(); ++i) {
    if (unsure[i] == 0x1f && unsure[i + 1] == 0x21) unsure[i] = 0x00, unsure[i + 1] = 0x7c;
  }
  ASSERT_NE(unsure, packed);
  const dronecan::Transfer blurred{.type_id = dronecan::GnssFix2::kType.id, .source = 9, .payload = unsure};
  ASSERT_TRUE(input_from_dronecan(blurred, &input));
  EXPECT_EQ(input.value[8], 0);
  EXPECT_NEAR(input.value[0], -47.39770005, 1e-9);
  // Cut anywhere: refused, or no place.
  for (std::size_t size = 0; size < 50; ++size) {
    const dronecan::Transfer cut{
        .type_id = dronecan::GnssFix2::kType.id, .source = 9, .payload = std::span(packed).first(size)};
    EXPECT_FALSE(input_from_dronecan(cut, &input)) << size;
  }
}

}  // namespace parts_test
}  // namespace godwit::link
