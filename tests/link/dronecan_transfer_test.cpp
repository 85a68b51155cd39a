#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <random>
#include <string>

#include "firmware_app/link/dronecan/transfer.h"
#include "firmware_app/link/dronecan/types.h"
#include "tests/link/hex.h"

namespace godwit::link::dronecan {
namespace dronecan_transfer_test {

constexpr rt::TimeNs kMs = rt::kNsPerMs;

std::vector<TypeInfo> all_types() {
  std::vector<TypeInfo> types;
  for_each_type([&]<typename T>() { types.push_back(T::kType); });
  return types;
}

std::vector<CanFrame> frames_of(const Transfer& transfer, const TypeInfo& type) {
  FrameBuffer buffer;
  const std::size_t count = to_frames(transfer, type.signature, &buffer);
  return {buffer.begin(), buffer.begin() + static_cast<std::ptrdiff_t>(count)};
}

template <typename T>
std::vector<CanFrame> frames_of(const T& value, Transfer transfer) {
  std::array<std::uint8_t, kMaxPayload> payload;
  transfer.kind = T::kType.kind;
  transfer.type_id = T::kType.id;
  transfer.payload = {payload.data(), encode(value, payload, transfer.fd)};
  return frames_of(transfer, T::kType);
}

void expect_frames(const std::vector<CanFrame>& frames, std::uint32_t id, const std::vector<std::string>& golden) {
  ASSERT_EQ(frames.size(), golden.size());
  for (std::size_t i = 0; i < frames.size(); ++i) {
    EXPECT_EQ(frames[i].id, id);
    EXPECT_EQ(to_hex({frames[i].data.data(), frames[i].length}), golden[i]) << "frame " << i;
  }
}

class Receiver {
 public:
  Receiver() : reassembler(all_types()) { reassembler.set_node_id(42); }
  bool accept(const CanFrame& frame) { return reassembler.accept(frame, now, &transfer); }
  bool accept_all(const std::vector<CanFrame>& frames) {
    bool done = false;
    for (const CanFrame& frame : frames) done = accept(frame);
    return done;
  }
  template <typename T>
  T decoded() {
    T value;
    EXPECT_TRUE(decode(transfer.payload, transfer.fd, &value));
    return value;
  }
  const ReassemblyCounters& counters() const { return reassembler.counters(); }
  Reassembler reassembler;
  Transfer transfer;
  rt::TimeNs now = rt::kNsPerSecond;
};

TunnelTargetted golden_tunnel() {
  TunnelTargetted t;
  t.protocol = 1;
  t.target_node = 10;
  t.options = 1;
  t.baudrate = 115200;
  t.buffer.size = 16;
  for (std::uint8_t i = 0; i < 16; ++i) t.buffer.item[i] = i;
  return t;
}

RangeMeasurement golden_range() {
  RangeMeasurement r;
  r.timestamp_us = 0x01020304050607;
  r.sensor_id = 3;
  r.roll_pitch_yaw = {0, -6, 0};
  r.orientation_defined = true;
  r.field_of_view_rad = 0.1F;
  r.sensor_type = 2;
  r.reading_type = 1;
  r.range_m = 12.5F;
  return r;
}

TEST(DronecanGolden, NodeStatus) {
  NodeStatus status;
  status.uptime_s = 1234;
  status.vendor_code = 0xBEEF;
  const auto frames = frames_of(status, {.priority = 20, .source = 42, .transfer_id = 5, .payload = {}});
  expect_frames(frames, 0x1401552A, {"d204000000efbec5"});
  Receiver r;
  ASSERT_TRUE(r.accept_all(frames));
  EXPECT_EQ(r.transfer.source, 42);
  EXPECT_EQ(r.transfer.transfer_id, 5);
  EXPECT_EQ(r.decoded<NodeStatus>().uptime_s, 1234U);
  EXPECT_EQ(r.decoded<NodeStatus>().vendor_code, 0xBEEF);
}

TEST(DronecanGolden, TunnelClassicAndFd) {
  Transfer t{.priority = 16, .source = 42, .payload = {}};
  const auto classic = frames_of(golden_tunnel(), t);
  expect_frames(classic, 0x100BB92A, {"85c601140100c280", "0100010203040520", "060708090a0b0c00", "0d0e0f60"});
  t.fd = true;
  const auto fd = frames_of(golden_tunnel(), t);
  expect_frames(fd, 0x100BB92A, {"01140100c2012000020406080a0c0e10121416181a1c1ec0"});
  for (const auto& frames : {classic, fd}) {
    Receiver r;
    ASSERT_TRUE(r.accept_all(frames));
    const auto back = r.decoded<TunnelTargetted>();
    EXPECT_EQ(back.protocol, 1);
    EXPECT_EQ(back.target_node, 10);
    EXPECT_EQ(back.options, 1);
    EXPECT_EQ(back.baudrate, 115200U);
    EXPECT_EQ(to_hex(back.buffer.view()), "000102030405060708090a0b0c0d0e0f");
  }
}

TEST(DronecanGolden, Range) {
  const auto frames = frames_of(golden_range(), {.priority = 20, .source = 50, .transfer_id = 1, .payload = {}});
  expect_frames(frames, 0x14041A32, {"c046070605040381", "0201030681662e21", "11404a41"});
  Receiver r;
  ASSERT_TRUE(r.accept_all(frames));
  const auto back = r.decoded<RangeMeasurement>();
  EXPECT_EQ(back.timestamp_us, 0x01020304050607U);
  EXPECT_EQ(back.roll_pitch_yaw[1], -6);
  EXPECT_FLOAT_EQ(back.range_m, 12.5F);
}

TEST(DronecanGolden, Flow) {
  FlowMeasurement flow;
  flow.interval_s = 0.05F;
  flow.gyro_integral = {0.01F, -0.02F};
  flow.flow_integral = {0.015F, -0.025F};
  flow.quality = 200;
  const auto frames = frames_of(flow, {.priority = 16, .source = 42, .transfer_id = 2, .payload = {}});
  expect_frames(frames, 0x104EE82A, {"8abfcdcc4c3d0a82", "d7233c0ad7a3bc22", "8fc2753ccdcccc02", "bcc862"});
  Receiver r;
  ASSERT_TRUE(r.accept_all(frames));
  EXPECT_EQ(r.decoded<FlowMeasurement>().quality, 200);
  EXPECT_EQ(r.decoded<FlowMeasurement>().flow_integral[1], -0.025F);
}

TEST(DronecanGolden, Services) {
  const auto info = frames_of(GetNodeInfoRequest{},
                              {.priority = 24, .source = 10, .destination = 42, .transfer_id = 7, .payload = {}});
  expect_frames(info, 0x1801AA8A, {"c7"});
  EXPECT_EQ(can_id({.kind = TransferKind::kResponse,
                    .type_id = 1,
                    .priority = 24,
                    .source = 42,
                    .destination = 10,
                    .payload = {}}),
            0x18010AAAU);
  GetSetRequest get;
  assign(&get.name, "VIO_RATE");
  const auto frames =
      frames_of(get, {.priority = 24, .source = 10, .destination = 42, .transfer_id = 1, .payload = {}});
  expect_frames(frames, 0x180BAA8A, {"4c99000056494f81", "5f5241544561"});
  Receiver r;
  ASSERT_TRUE(r.accept_all(info));
  EXPECT_EQ(r.transfer.kind, TransferKind::kRequest);
  ASSERT_TRUE(r.accept_all(frames));
  EXPECT_EQ(text_of(r.decoded<GetSetRequest>().name), "VIO_RATE");
}

// Every payload length, both kinds of bus: what goes out comes back, in frames of lengths that exist.
TEST(DronecanTransfer, EveryLengthComesBack) {
  std::mt19937 random(1);
  TypeInfo type{"test", TransferKind::kMessage, 100, 0x123456789ABCDEF0, kMaxPayload};
  Reassembler reassembler({type});
  std::vector<std::uint8_t> payload;
  rt::TimeNs now = 0;
  for (std::size_t size = 0; size <= kMaxPayload; ++size) {
    for (const bool fd : {false, true}) {
      Transfer t{.type_id = 100,
                 .source = 3,
                 .transfer_id = static_cast<std::uint8_t>(size % 32),
                 .fd = fd,
                 .payload = payload};
      const auto frames = frames_of(t, type);
      ASSERT_FALSE(frames.empty());
      now += 3 * rt::kNsPerSecond;
      Transfer back;
      bool done = false;
      for (const CanFrame& f : frames) {
        if (fd) {
          EXPECT_EQ(hal::fd_frame_length(f.length), f.length);
        }
        done = reassembler.accept(f, now, &back);
      }
      ASSERT_TRUE(done) << size;
      ASSERT_GE(back.payload.size(), size);
      EXPECT_TRUE(std::equal(payload.begin(), payload.end(), back.payload.begin()));
      for (const std::uint8_t b : back.payload.subspan(size)) EXPECT_EQ(b, 0);
    }
    payload.push_back(static_cast<std::uint8_t>(random()));
  }
  EXPECT_EQ(reassembler.counters().errors(), 0U);
  FrameBuffer buffer;
  EXPECT_EQ(to_frames({.type_id = 100, .source = 3, .payload = payload}, 0, &buffer), 0U) << "longer than any type";
  EXPECT_EQ(to_frames({.type_id = 1, .source = 0, .payload = {payload.data(), 8}}, 0, &buffer), 0U)
      << "an anonymous transfer has one frame";
}

class Faults : public ::testing::Test {
 protected:
  void SetUp() override { frames = frames_of(golden_tunnel(), {.source = 10, .transfer_id = 3, .payload = {}}); }
  // The next transfer must come through, whatever was before.
  void expect_recovery(std::uint8_t transfer_id = 4) {
    const auto next = frames_of(golden_tunnel(), {.source = 10, .transfer_id = transfer_id, .payload = {}});
    EXPECT_TRUE(r.accept_all(next));
  }
  Receiver r;
  std::vector<CanFrame> frames;
};

TEST_F(Faults, LostFrameGivesNothingAndIsCounted) {
  for (std::size_t lost = 0; lost < frames.size(); ++lost) {
    Receiver fresh;
    bool any = false;
    for (std::size_t i = 0; i < frames.size(); ++i) {
      if (i != lost) any = any || fresh.accept(frames[i]);
    }
    EXPECT_FALSE(any) << lost;
    const auto next = frames_of(golden_tunnel(), {.source = 10, .transfer_id = 4, .payload = {}});
    EXPECT_TRUE(fresh.accept_all(next)) << lost;
    EXPECT_GE(fresh.counters().errors(), 1U) << lost;
  }
}

TEST_F(Faults, EveryRepeatedFrameIsPassedOver) {
  for (std::size_t again = 0; again < frames.size(); ++again) {
    Receiver fresh;
    int delivered = 0;
    for (std::size_t i = 0; i < frames.size(); ++i) {
      delivered += fresh.accept(frames[i]) ? 1 : 0;
      if (i == again) delivered += fresh.accept(frames[i]) ? 1 : 0;
    }
    EXPECT_EQ(delivered, 1) << again;
    EXPECT_EQ(fresh.counters().repeated, 1U) << again;
    EXPECT_EQ(fresh.counters().errors(), 0U) << again;
  }
}

TEST_F(Faults, RepeatedTransferIsDeliveredOnce) {
  EXPECT_TRUE(r.accept_all(frames));
  EXPECT_FALSE(r.accept_all(frames));
  EXPECT_EQ(r.counters().transfers, 1U);
  r.now += 3 * rt::kNsPerSecond;  // long after, the same transfer id is a new transfer
  EXPECT_TRUE(r.accept_all(frames));
}

TEST_F(Faults, ReorderedFrames) {
  std::swap(frames[1], frames[2]);
  EXPECT_FALSE(r.accept_all(frames));
  EXPECT_GE(r.counters().wrong_toggle, 1U);
  expect_recovery();
}

TEST_F(Faults, WrongToggle) {
  frames[1].data[7] = static_cast<std::uint8_t>(frames[1].data[7] ^ 0x20U);
  EXPECT_FALSE(r.accept_all(frames));
  EXPECT_EQ(r.counters().wrong_toggle, 1U);
  frames[0].data[7] = static_cast<std::uint8_t>(frames[0].data[7] ^ 0x20U);
  EXPECT_FALSE(r.accept(frames[0]));
  EXPECT_EQ(r.counters().wrong_toggle, 2U);
  expect_recovery();
}

TEST_F(Faults, EveryFlippedPayloadBitFailsTheCrcAndTheRepetitionIsTaken) {
  for (std::size_t frame = 0; frame < frames.size(); ++frame) {
    for (std::size_t bit = 0; bit < 8 * (frames[frame].length - 1U); ++bit) {
      Receiver fresh;
      auto bad = frames;
      bad[frame].data[bit / 8] = static_cast<std::uint8_t>(bad[frame].data[bit / 8] ^ (1U << (bit % 8)));
      EXPECT_FALSE(fresh.accept_all(bad));
      EXPECT_EQ(fresh.counters().bad_crc, 1U);
      EXPECT_TRUE(fresh.accept_all(frames));
    }
  }
}

TEST_F(Faults, AnotherTypesSignatureFailsTheCrc) {
  TypeInfo other = TunnelTargetted::kType;
  other.signature ^= 1;
  Reassembler wrong({other});
  Transfer out;
  bool done = false;
  for (const CanFrame& f : frames) done = wrong.accept(f, 0, &out);
  EXPECT_FALSE(done);
  EXPECT_EQ(wrong.counters().bad_crc, 1U);
}

TEST_F(Faults, StaleTransferId) {
  EXPECT_FALSE(r.accept(frames[0]));
  frames[1].data[7] = static_cast<std::uint8_t>((frames[1].data[7] & 0xE0U) | 9U);
  EXPECT_FALSE(r.accept(frames[1]));
  EXPECT_EQ(r.counters().wrong_transfer_id, 1U);
  expect_recovery();
}

TEST_F(Faults, TimeOut) {
  EXPECT_FALSE(r.accept(frames[0]));
  r.now += 2 * rt::kNsPerSecond + kMs;
  for (std::size_t i = 1; i < frames.size(); ++i) EXPECT_FALSE(r.accept(frames[i]));
  EXPECT_EQ(r.counters().timed_out, 1U);
  EXPECT_EQ(r.counters().missed_start, 2U);
  expect_recovery(3);
}

TEST_F(Faults, SenderBeginsAnew) {
  EXPECT_FALSE(r.accept(frames[0]));
  EXPECT_FALSE(r.accept(frames[1]));
  expect_recovery(4);
  EXPECT_EQ(r.counters().aborted, 1U);
}

TEST_F(Faults, TooLongForItsType) {
  CanFrame middle = frames[1];
  EXPECT_FALSE(r.accept(frames[0]));
  for (int i = 0; i < 40; ++i) {
    middle.data[7] = static_cast<std::uint8_t>((i % 2 == 0 ? 0x20 : 0) | 3);
    EXPECT_FALSE(r.accept(middle));
  }
  EXPECT_EQ(r.counters().too_long, 1U);
  expect_recovery();
}

TEST_F(Faults, ShortMiddleFrameAndEmptyFrame) {
  EXPECT_FALSE(r.accept(frames[0]));
  frames[1].data[6] = frames[1].data[7];
  frames[1].length = 7;
  EXPECT_FALSE(r.accept(frames[1]));
  CanFrame empty;
  empty.id = frames[0].id;
  EXPECT_FALSE(r.accept(empty));
  EXPECT_EQ(r.counters().malformed, 2U);
}

TEST_F(Faults, ForeignFramesAreNoErrors) {
  CanFrame eleven;
  eleven.extended = false;
  eleven.id = 0x123;
  eleven.length = 8;
  EXPECT_FALSE(r.accept(eleven));
  const auto other = frames_of(GetNodeInfoRequest{}, {.priority = 24, .source = 10, .destination = 43, .payload = {}});
  EXPECT_FALSE(r.accept_all(other));
  r.reassembler.set_node_id(0);  // without an id nobody can ask us
  const auto ours = frames_of(GetNodeInfoRequest{}, {.priority = 24, .source = 10, .destination = 42, .payload = {}});
  EXPECT_FALSE(r.accept_all(ours));
  EXPECT_EQ(r.counters().foreign, 3U);
  EXPECT_EQ(r.counters().errors(), 0U);
}

TEST_F(Faults, AFloodOfSendersCannotSilenceTheAutopilot) {
  r.reassembler.protect_source(10);
  std::mt19937 random(7);
  std::size_t next = 0;
  int delivered = 0;
  for (int i = 0; i < 20000; ++i) {
    r.now += kMs / 10;
    // First frames of transfers that never end, from every node and of every message type.
    Transfer t{.source = static_cast<std::uint8_t>(11 + random() % 117),
               .transfer_id = static_cast<std::uint8_t>(random() % 32),
               .payload = {}};
    r.accept((random() % 2 == 0 ? frames_of(golden_tunnel(), t) : frames_of(golden_range(), t))[0]);
    if (i % 10 == 0) {
      delivered += r.accept(frames[next]) ? 1 : 0;
      next = (next + 1) % frames.size();
      if (next == 0) {
        for (CanFrame& f : frames) {
          std::uint8_t& tail = f.data[f.length - 1U];
          tail = static_cast<std::uint8_t>((tail & 0xE0U) | ((tail + 1U) & 0x1FU));
        }
      }
    }
  }
  EXPECT_EQ(delivered, 2000 / 4);
  EXPECT_GT(r.counters().evicted, 1000U);
}

TEST(DronecanAnonymous, OneFrameWithADiscriminator) {
  Allocation request;
  request.first_part = true;
  request.unique_id.size = 6;
  std::array<std::uint8_t, kMaxPayload> payload;
  Transfer t{.type_id = 1, .priority = 30, .source = 0, .payload = {payload.data(), encode(request, payload, false)}};
  const auto frames = frames_of(t, Allocation::kType);
  ASSERT_EQ(frames.size(), 1U);
  EXPECT_EQ(frames[0].id & 0x3FF, 1U << 8);
  Receiver r;
  ASSERT_TRUE(r.accept_all(frames));
  EXPECT_EQ(r.transfer.source, 0);
  EXPECT_EQ(r.decoded<Allocation>().unique_id.size, 6U);
}

TEST(DronecanDecode, ShortPayloadsAndLongArraysAreRefused) {
  const std::array<std::uint8_t, 6> short_status{};
  NodeStatus status;
  EXPECT_FALSE(decode(short_status, false, &status));
  const std::vector<std::uint8_t> long_tunnel(127 + 1);
  TunnelTargetted tunnel;
  EXPECT_FALSE(decode(std::span<const std::uint8_t>(long_tunnel), false, &tunnel));
  EXPECT_EQ(tunnel.buffer.size, 0U);
}

TEST(Half, SpecialValues) {
  EXPECT_EQ(half_from_float(1.0F), 0x3C00);
  EXPECT_EQ(half_from_float(-2.0F), 0xC000);
  EXPECT_EQ(half_from_float(1e9F), 0x7BFF) << "saturated";
  EXPECT_EQ(half_from_float(0x1p-24F), 1);
  EXPECT_EQ(half_from_float(0x1p-26F), 0);
  EXPECT_EQ(half_from_float(std::numeric_limits<float>::quiet_NaN()), 0x7FFF);
  for (unsigned h = 0; h < 0x10000; ++h) {
    const float value = float_from_half(static_cast<std::uint16_t>(h));
    if ((h & 0x7FFFU) < 0x7C00) {
      EXPECT_EQ(half_from_float(value), h);
    }
  }
  EXPECT_TRUE(std::isinf(float_from_half(0x7C00)));
  EXPECT_TRUE(std::isnan(float_from_half(0x7E00)));
}

}  // namespace dronecan_transfer_test
}  // namespace godwit::link::dronecan
