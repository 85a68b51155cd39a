// Frames byte for byte as an independent implementation makes them.
#include <gtest/gtest.h>
#include <string>

#include "tests/link/dronecan_frames.h"
#include "tests/link/hex.h"

namespace godwit::link::dronecan {
namespace dronecan_golden_test {

void expect_frames(const std::vector<CanFrame>& frames, std::uint32_t id, const std::vector<std::string>& golden) {
  ASSERT_EQ(frames.size(), golden.size());
  for (std::size_t i = 0; i < frames.size(); ++i) {
    EXPECT_EQ(frames[i].id, id);
    EXPECT_EQ(to_hex({frames[i].data.data(), frames[i].length}), golden[i]) << "frame " << i;
  }
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

}  // namespace dronecan_golden_test
}  // namespace godwit::link::dronecan
