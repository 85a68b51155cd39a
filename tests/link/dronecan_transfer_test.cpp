#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <random>
#include <string>

#include "tests/link/dronecan_frames.h"
#include "tests/link/hex.h"

namespace godwit::link::dronecan {
namespace dronecan_transfer_test {

constexpr rt::TimeNs kMs = rt::kNsPerMs;

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
