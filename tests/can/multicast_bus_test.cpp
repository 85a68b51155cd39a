#include "hal/can/multicast_bus.h"

#include <gtest/gtest.h>
#include <poll.h>
#include <random>

namespace godwit::hal::multicast_bus_test {
namespace {

CanFrame node_status() {
  CanFrame frame;
  frame.id = 0x1401552A;
  frame.length = 8;
  frame.data = {0xd2, 0x04, 0, 0, 0, 0xef, 0xbe, 0xc5};
  return frame;
}

TEST(MulticastDatagram, GoldenNodeStatus) {
  const std::array<std::uint8_t, 18> golden{0x34, 0x29, 0xe6, 0x1d, 0x00, 0x00, 0x2a, 0x55, 0x01,
                                            0x94, 0xd2, 0x04, 0x00, 0x00, 0x00, 0xef, 0xbe, 0xc5};
  MulticastDatagram datagram;
  const std::size_t length = encode_datagram(node_status(), &datagram);
  ASSERT_EQ(length, golden.size());
  EXPECT_TRUE(std::equal(golden.begin(), golden.end(), datagram.begin()));
  CanFrame back;
  ASSERT_TRUE(decode_datagram(golden, &back));
  EXPECT_EQ(back.id, 0x1401552AU);
  EXPECT_TRUE(back.extended);
  EXPECT_FALSE(back.fd);
  EXPECT_EQ(back.length, 8);
  EXPECT_EQ(back.data, node_status().data);
}

TEST(MulticastDatagram, RandomFramesComeBack) {
  std::mt19937 random(1);
  for (int i = 0; i < 20000; ++i) {
    CanFrame frame;
    frame.fd = (random() & 1U) != 0;
    frame.extended = (random() & 1U) != 0;
    frame.id = static_cast<std::uint32_t>(random()) & (frame.extended ? 0x1FFFFFFFU : 0x7FFU);
    frame.length = static_cast<std::uint8_t>(random() % (frame.fd ? 65 : 9));
    for (int k = 0; k < frame.length; ++k)
      frame.data[static_cast<std::size_t>(k)] = static_cast<std::uint8_t>(random());
    MulticastDatagram datagram;
    const std::size_t length = encode_datagram(frame, &datagram);
    CanFrame back;
    ASSERT_TRUE(decode_datagram({datagram.data(), length}, &back));
    EXPECT_EQ(back.id, frame.id);
    EXPECT_EQ(back.extended, frame.extended);
    EXPECT_EQ(back.fd, frame.fd);
    EXPECT_EQ(back.length, frame.length);
    EXPECT_EQ(back.data, frame.data);
  }
}

TEST(MulticastDatagram, EveryFlippedBitIsNoticed) {
  MulticastDatagram datagram;
  const std::size_t length = encode_datagram(node_status(), &datagram);
  CanFrame back;
  for (std::size_t bit = 0; bit < 8 * length; ++bit) {
    MulticastDatagram bad = datagram;
    bad[bit / 8] = static_cast<std::uint8_t>(bad[bit / 8] ^ (1U << (bit % 8)));
    EXPECT_FALSE(decode_datagram({bad.data(), length}, &back)) << bit;
  }
  for (std::size_t shorter = 0; shorter < length; ++shorter) {
    EXPECT_FALSE(decode_datagram({datagram.data(), shorter}, &back)) << shorter;
  }
}

// Loopback takes multicast here as long as it is told which interface to use; bus 9 keeps clear of the other tests.
class MulticastLoopback : public ::testing::Test {
 protected:
  void SetUp() override {
    auto first = MulticastBus::open(9, "127.0.0.1"), second = MulticastBus::open(9, "127.0.0.1");
    ASSERT_TRUE(first.ok()) << first.error().message;
    ASSERT_TRUE(second.ok()) << second.error().message;
    a = std::move(first).value();
    b = std::move(second).value();
  }
  static bool receive_soon(MulticastBus& bus, CanFrame* frame) {
    pollfd waiting{bus.descriptor(), POLLIN, 0};
    return poll(&waiting, 1, 2000) == 1 && bus.receive(frame);
  }
  std::unique_ptr<MulticastBus> a, b;
};

TEST_F(MulticastLoopback, FramesReachTheOtherAndNotOurselves) {
  ASSERT_EQ(a->send(node_status()), CanSend::kSent);
  CanFrame got;
  ASSERT_TRUE(receive_soon(*b, &got));
  EXPECT_EQ(got.id, 0x1401552AU);
  EXPECT_FALSE(a->receive(&got));
  EXPECT_EQ(a->counters().sent, 1U);
  EXPECT_EQ(b->counters().received, 1U);
}

TEST_F(MulticastLoopback, FiltersHoldBack) {
  const std::array<CanFilter, 1> filter{CanFilter{0x00015600, 0x00FFFF80, true}};
  ASSERT_TRUE(b->set_filters(filter).ok());
  CanFrame other = node_status();
  other.id = 0x1401562A;
  ASSERT_EQ(a->send(node_status()), CanSend::kSent);
  ASSERT_EQ(a->send(other), CanSend::kSent);
  CanFrame got;
  ASSERT_TRUE(receive_soon(*b, &got));
  EXPECT_EQ(got.id, 0x1401562AU);
  EXPECT_FALSE(b->receive(&got));
  const std::vector<CanFilter> many(CanBus::kMaxFilters + 1);
  EXPECT_FALSE(b->set_filters(many).ok());
}

}  // namespace
}  // namespace godwit::hal::multicast_bus_test
