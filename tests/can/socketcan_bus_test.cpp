#include "hal/can/socketcan_bus.h"

#include <cstring>
#include <gtest/gtest.h>
#include <linux/can/error.h>
#include <linux/can/netlink.h>
#include <linux/if_link.h>
#include <linux/rtnetlink.h>
#include <span>
#include <sys/socket.h>
#include <unistd.h>

#include "hal/can/can_link.h"
#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"

namespace godwit::hal::socketcan_bus_test {
namespace {

// The kernel's side of the socket, played by the test.
class AdoptedBus : public ::testing::Test {
 protected:
  void SetUp() override {
    std::array<int, 2> pair{};
    ASSERT_EQ(socketpair(AF_UNIX, SOCK_DGRAM | SOCK_NONBLOCK, 0, pair.data()), 0);
    bus = SocketCanBus::adopt(pair[0]);
    peer = pair[1];
  }
  void TearDown() override {
    if (peer >= 0) close(peer);
  }
  void kernel_sends(const canfd_frame& raw, std::size_t size) {
    ASSERT_EQ(::send(peer, &raw, size, 0), static_cast<ssize_t>(size));
  }
  std::unique_ptr<SocketCanBus> bus;
  int peer = -1;
};

TEST_F(AdoptedBus, SendsKernelFrames) {
  CanFrame frame;
  frame.id = 0x1401552A;
  frame.length = 3;
  frame.data = {1, 2, 3};
  ASSERT_EQ(bus->send(frame), CanSend::kSent);
  canfd_frame raw{};
  ASSERT_EQ(recv(peer, &raw, sizeof raw, 0), static_cast<ssize_t>(CAN_MTU));
  EXPECT_EQ(raw.can_id, 0x1401552AU | CAN_EFF_FLAG);
  EXPECT_EQ(raw.len, 3);
  EXPECT_EQ(raw.data[2], 3);
  frame.fd = true;
  frame.length = 64;
  frame.extended = false;
  frame.id = 0x123;
  ASSERT_EQ(bus->send(frame), CanSend::kSent);
  ASSERT_EQ(recv(peer, &raw, sizeof raw, 0), static_cast<ssize_t>(CANFD_MTU));
  EXPECT_EQ(raw.can_id, 0x123U);
  EXPECT_EQ(raw.len, 64);
  EXPECT_EQ(raw.flags, CANFD_BRS);
}

TEST_F(AdoptedBus, ReceivesClassicAndFdAndRefusesNonsense) {
  canfd_frame raw{};
  raw.can_id = 0x1FFFFFFF | CAN_EFF_FLAG;
  raw.len = 8;
  raw.data[7] = 7;
  kernel_sends(raw, CAN_MTU);
  raw.can_id = 0x7FF;
  raw.len = 64;
  raw.data[63] = 63;
  kernel_sends(raw, CANFD_MTU);
  raw.len = 9;  // longer than a classic frame can be
  kernel_sends(raw, CAN_MTU);
  kernel_sends(raw, 5);
  raw.can_id = 0x100 | CAN_RTR_FLAG;
  raw.len = 0;
  kernel_sends(raw, CAN_MTU);
  CanFrame frame;
  ASSERT_TRUE(bus->receive(&frame));
  EXPECT_EQ(frame.id, 0x1FFFFFFFU);
  EXPECT_TRUE(frame.extended);
  EXPECT_FALSE(frame.fd);
  EXPECT_EQ(frame.data[7], 7);
  ASSERT_TRUE(bus->receive(&frame));
  EXPECT_EQ(frame.id, 0x7FFU);
  EXPECT_FALSE(frame.extended);
  EXPECT_TRUE(frame.fd);
  EXPECT_EQ(frame.length, 64);
  EXPECT_EQ(frame.data[63], 63);
  EXPECT_FALSE(bus->receive(&frame));
  EXPECT_EQ(bus->counters().received, 2U);
  EXPECT_EQ(bus->counters().receive_malformed, 2U);
}

TEST_F(AdoptedBus, ErrorFramesDriveTheStateAndBusOffStopsSending) {
  canfd_frame raw{};
  raw.len = 8;
  raw.can_id = CAN_ERR_FLAG | CAN_ERR_CRTL;
  raw.data[1] = CAN_ERR_CRTL_TX_WARNING;
  CanFrame frame;
  kernel_sends(raw, CAN_MTU);
  EXPECT_FALSE(bus->receive(&frame));
  EXPECT_EQ(bus->state(), CanState::kWarning);
  raw.data[1] = CAN_ERR_CRTL_TX_PASSIVE;
  kernel_sends(raw, CAN_MTU);
  EXPECT_FALSE(bus->receive(&frame));
  EXPECT_EQ(bus->state(), CanState::kPassive);
  raw.can_id = CAN_ERR_FLAG | CAN_ERR_BUSOFF;
  kernel_sends(raw, CAN_MTU);
  EXPECT_FALSE(bus->receive(&frame));
  EXPECT_EQ(bus->state(), CanState::kBusOff);
  EXPECT_EQ(bus->counters().bus_off, 1U);
  EXPECT_EQ(bus->send(frame), CanSend::kDown);
  raw.can_id = CAN_ERR_FLAG | CAN_ERR_RESTARTED;
  kernel_sends(raw, CAN_MTU);
  EXPECT_FALSE(bus->receive(&frame));
  EXPECT_EQ(bus->state(), CanState::kActive);
  EXPECT_EQ(bus->send(frame), CanSend::kSent);
  EXPECT_EQ(bus->counters().error_frames, 4U);
}

TEST_F(AdoptedBus, FullQueueIsNotAnErrorAndLosesNothing) {
  CanFrame frame;
  frame.length = 8;
  int sent = 0;
  while (bus->send(frame) == CanSend::kSent) {
    ASSERT_LT(++sent, 100000);
  }
  EXPECT_EQ(bus->send(frame), CanSend::kFull);
  EXPECT_EQ(bus->state(), CanState::kActive);
  EXPECT_GE(bus->counters().send_full, 2U);
  canfd_frame raw{};
  int read = 0;
  while (recv(peer, &raw, sizeof raw, 0) > 0) ++read;
  EXPECT_EQ(read, sent);
  EXPECT_EQ(bus->send(frame), CanSend::kSent);
}

TEST_F(AdoptedBus, FramesBothWaysTakeNoHeap) {
  canfd_frame raw{};
  raw.can_id = CAN_EFF_FLAG;
  raw.len = 8;
  CanFrame frame;
  frame.length = 8;
  const rt::HeapCounts before = rt::rt_heap_counts();
  for (int i = 0; i < 1000; ++i) {
    kernel_sends(raw, CAN_MTU);
    {
      const rt::RtScope scope;
      ASSERT_TRUE(bus->receive(&frame));
      ASSERT_EQ(bus->send(frame), CanSend::kSent);
      bus->maintain(i * rt::kNsPerSecond);
    }
    ASSERT_GT(recv(peer, &raw, sizeof raw, 0), 0);
  }
  EXPECT_EQ(rt::rt_heap_counts().allocations, before.allocations);
  EXPECT_EQ(rt::rt_heap_counts().frees, before.frees);
}

TEST_F(AdoptedBus, PeerGoneMeansBusGone) {
  close(peer);
  peer = -1;
  CanFrame frame;
  EXPECT_EQ(bus->send(frame), CanSend::kDown);
  EXPECT_EQ(bus->state(), CanState::kGone);
  EXPECT_EQ(bus->descriptor(), -1);
  EXPECT_FALSE(bus->receive(&frame));
  bus->maintain(rt::kNsPerSecond);
  EXPECT_EQ(bus->state(), CanState::kGone);
}

TEST(CanLink, ReadsTheLoopbackInterface) {
  const auto link = read_can_link("lo");
  ASSERT_TRUE(link.ok()) << link.error().message;
  EXPECT_FALSE(link.value().qdisc.empty());
  EXPECT_TRUE(link.value().kind.empty());
  const auto none = read_can_link("nosuchif");
  ASSERT_FALSE(none.ok());
  EXPECT_NE(none.error().message.find("nosuchif: No such device"), std::string::npos) << none.error().message;
}

/// Calls visit(type, payload) for each attribute of a block, nested flags taken off.
template <typename Visit>
void for_each_attribute(std::span<const std::uint8_t> block, Visit visit) {
  while (block.size() >= sizeof(rtattr)) {
    rtattr attribute{};
    std::memcpy(&attribute, block.data(), sizeof attribute);
    ASSERT_TRUE(attribute.rta_len >= sizeof attribute && attribute.rta_len <= block.size());
    visit(attribute.rta_type & NLA_TYPE_MASK, block.subspan(RTA_LENGTH(0), attribute.rta_len - RTA_LENGTH(0)));
    block = block.subspan(std::min<std::size_t>(RTA_ALIGN(attribute.rta_len), block.size()));
  }
}

// What drivers/net/can/dev/netlink.c wants: RTM_NEWLINK with IFLA_LINKINFO {IFLA_INFO_KIND "can", IFLA_INFO_DATA
// {IFLA_CAN_RESTART 1}}.
TEST(CanLink, TheRestartMessageAsksTheCanDriverToRestart) {
  const std::vector<std::uint8_t> message = can_restart_message();
  ASSERT_GE(message.size(), NLMSG_SPACE(sizeof(ifinfomsg)));
  nlmsghdr header{};
  std::memcpy(&header, message.data(), sizeof header);
  EXPECT_EQ(header.nlmsg_len, message.size());
  EXPECT_EQ(header.nlmsg_type, RTM_NEWLINK);
  EXPECT_EQ(header.nlmsg_flags, NLM_F_REQUEST) << "it is not waited for an answer";
  std::string kind;
  std::uint32_t restart = 0;
  int others = 0;
  for_each_attribute(std::span(message).subspan(NLMSG_SPACE(sizeof(ifinfomsg))), [&](int type, auto info) {
    if (type != IFLA_LINKINFO) ++others;
    for_each_attribute(info, [&](int part, auto value) {
      if (part == IFLA_INFO_KIND) kind = reinterpret_cast<const char*>(value.data());
      if (part != IFLA_INFO_DATA) return;
      for_each_attribute(value, [&](int what, auto number) {
        if (what != IFLA_CAN_RESTART) ++others;
        std::memcpy(&restart, number.data(), sizeof restart);
      });
    });
  });
  EXPECT_EQ(kind.substr(0, 3), "can");
  EXPECT_EQ(restart, 1u);
  EXPECT_EQ(others, 0) << "nothing else of the interface is touched";
}

TEST(CanLink, AskingForARestartAllocatesNothing) {
  CanRestarter restarter;
  const rt::HeapCounts before = rt::rt_heap_counts();
  {
    const rt::RtScope scope;
    restarter.request(1 << 30);  // of an interface that is not there: the kernel's refusal is not waited for
  }
  EXPECT_EQ(rt::rt_heap_counts().allocations, before.allocations);
}

TEST(CanLink, AdviceNamesTheCommand) {
  CanLinkInfo info{"can0", "can", "pfifo_fast", true, 200, 100, 1000000, false};
  EXPECT_TRUE(can_link_advice(info).empty());
  info.txqueuelen = 10;
  info.qdisc = "fq_codel";
  info.restart_ms = 0;
  const auto advice = can_link_advice(info);
  ASSERT_EQ(advice.size(), 3U);
  EXPECT_NE(advice[0].find("ip link set can0 txqueuelen 200"), std::string::npos);
  EXPECT_NE(advice[1].find("tc qdisc replace dev can0"), std::string::npos);
  EXPECT_NE(advice[2].find("restart-ms 100"), std::string::npos);
  info.up = false;
  EXPECT_NE(can_link_advice(info)[0].find("ip link set can0 up"), std::string::npos);
}

}  // namespace
}  // namespace godwit::hal::socketcan_bus_test
