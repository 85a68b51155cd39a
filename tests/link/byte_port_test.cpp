// Ports that carry bytes: UDP, a serial line, and one that goes and comes.
#include "firmware_app/link/byte_port.h"

#include <array>
#include <cstdlib>
#include <fcntl.h>
#include <gtest/gtest.h>
#include <net/if.h>
#include <sched.h>
#include <string>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <thread>
#include <unistd.h>
#include <vector>

#include "tests/link/hex.h"
#include "tests/link/serial_line.h"
#include "tests/support/temp_folder.h"

namespace godwit::link {
namespace byte_port_test {

TEST(BytePort, ASerialLineThatGoesIsLeftAloneAndOpenedAgain) {
  const test::TempFolder folder;
  test::SerialLine line(folder / "tty");
  auto opened = open_byte_port("serial:" + line.name + ":115200");
  ASSERT_TRUE(opened.ok()) << opened.error().message;
  BytePort& port = *opened.value();
  EXPECT_EQ(port.baud_rate(), 115200);
  const std::array<std::uint8_t, 20> message{};
  std::array<std::uint8_t, 100> into{};
  EXPECT_TRUE(port.send(message, TxClass::kFlight));
  line.unplug();
  EXPECT_EQ(port.receive(into), 0u);
  EXPECT_TRUE(port.gone());
  EXPECT_EQ(port.descriptor(), -1) << "poll would return at once for ever";
  EXPECT_FALSE(port.send(message, TxClass::kPose));
  rt::TimeNs now = 100 * rt::kNsPerSecond;
  port.maintain(now);
  EXPECT_TRUE(port.gone());
  line.plug();
  port.maintain(now + rt::kNsPerMs);
  EXPECT_TRUE(port.gone()) << "tried once a second";
  port.maintain(now + rt::kNsPerSecond);  // two are promised
  EXPECT_FALSE(port.gone());
  EXPECT_TRUE(port.send(message, TxClass::kFlight));
  EXPECT_EQ(port.receive(into), 0u);
  EXPECT_FALSE(port.gone());
}

// A name by path holds colons, and the device may come after us.
TEST(BytePort, ASerialLineThatIsNotThereYetIsWaitedFor) {
  const test::TempFolder folder;
  test::SerialLine line(folder / "usb-0:2.1:1.0-port0");
  line.unplug();
  const std::string address = "serial:" + line.name + ":115200";
  EXPECT_TRUE(check_byte_port_address(address).ok());
  const auto refused = open_byte_port(address);
  ASSERT_FALSE(refused.ok()) << "a tool is to say so";
  EXPECT_NE(refused.error().message.find("No such file"), std::string::npos) << refused.error().message;
  EXPECT_FALSE(open_byte_port("serial:/dev/null:115200", true).ok()) << "that will never be one";
  auto opened = open_byte_port(address, true);
  ASSERT_TRUE(opened.ok()) << opened.error().message;
  BytePort& port = *opened.value();
  rt::TimeNs now = 100 * rt::kNsPerSecond;
  port.maintain(now);
  EXPECT_TRUE(port.gone());
  line.plug();
  port.maintain(now + rt::kNsPerSecond);
  EXPECT_FALSE(port.gone());
  EXPECT_TRUE(port.send(std::array<std::uint8_t, 20>{}, TxClass::kFlight));
}

TEST(BytePort, UdpBeforeTheNetworkIsUpIsWaitedFor) {
  bool alone = true;
  // A network of this thread's own, where not even the loopback is up.
  std::thread([&alone] {
    alone = unshare(CLONE_NEWNET) == 0;
    if (!alone) return;
    const std::string address = "udp:127.0.0.1:47122";
    EXPECT_FALSE(open_byte_port(address).ok()) << "a tool is to say so";
    auto opened = open_byte_port(address, true);
    ASSERT_TRUE(opened.ok()) << opened.error().message;
    BytePort& port = *opened.value();
    const std::array<std::uint8_t, 20> message{};
    std::array<std::uint8_t, 20> into{};
    port.maintain(rt::kNsPerSecond);
    EXPECT_TRUE(port.gone());
    EXPECT_FALSE(port.send(message, TxClass::kPose));
    EXPECT_EQ(port.receive(into), 0u);
    const int any = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    ifreq loopback{};
    std::string("lo").copy(loopback.ifr_name, IFNAMSIZ - 1);
    loopback.ifr_flags = IFF_UP;
    EXPECT_EQ(ioctl(any, SIOCSIFFLAGS, &loopback), 0);
    close(any);
    port.maintain(2 * rt::kNsPerSecond);
    EXPECT_FALSE(port.gone());
    EXPECT_TRUE(port.send(message, TxClass::kPose));
  }).join();
  if (alone) return;
  const char* const ci = std::getenv("CI");
  if (ci != nullptr && std::string(ci) == "true") FAIL() << "needs the right to a network of its own";
  GTEST_SKIP() << "needs the right to a network of its own";
}

TEST(BytePort, SaysWhatItExpected) {
  for (const char* bad :
       {"", "udp", "udp:localhost:14550", "udp:127.0.0.1:0", "udp:127.0.0.1:70000", "serial:/dev/null",
        "serial:/dev/null:12345", "serial:/nonexistent:115200", "serial:/dev/null:115200"}) {
    const auto port = open_byte_port(bad);
    ASSERT_FALSE(port.ok()) << bad;
    EXPECT_NE(port.error().message.find("MAVLink port"), std::string::npos);
  }
}

TEST(BytePort, UdpBothWays) {
  auto a = open_byte_port("udp:127.0.0.1:47121:47120"), b = open_byte_port("udp:127.0.0.1:47120:47121");
  ASSERT_TRUE(a.ok() && b.ok());
  const std::vector<std::uint8_t> message{1, 2, 3};
  EXPECT_TRUE(a.value()->send(message, TxClass::kPose));
  std::array<std::uint8_t, 16> got{};
  std::size_t size = 0;
  for (int i = 0; i < 2000 && size == 0; ++i) {
    size = b.value()->receive(got);
    if (size == 0) usleep(1000);
  }
  EXPECT_EQ(to_hex({got.data(), size}), "010203");
  EXPECT_EQ(a.value()->receive(got), 0U);
}

TEST(BytePort, SerialThroughAPseudoTerminal) {
  const int master = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
  ASSERT_GE(master, 0);
  ASSERT_EQ(grantpt(master), 0);
  ASSERT_EQ(unlockpt(master), 0);
  std::array<char, 64> name{};
  ASSERT_EQ(ptsname_r(master, name.data(), name.size()), 0);
  auto port = open_byte_port("serial:" + std::string(name.data()) + ":921600");
  ASSERT_TRUE(port.ok()) << port.error().message;
  const std::vector<std::uint8_t> message{0x0A, 0x0D, 0x11, 0x13, 0x00, 0xFD};  // nothing is translated or swallowed
  EXPECT_TRUE(port.value()->send(message, TxClass::kFlight));
  std::array<std::uint8_t, 16> got{};
  const ssize_t size = read(master, got.data(), got.size());
  ASSERT_EQ(size, 6);
  EXPECT_EQ(to_hex({got.data(), 6}), "0a0d111300fd");
  ASSERT_EQ(write(master, message.data(), message.size()), 6);
  EXPECT_EQ(port.value()->receive(got), 6U);
  // Nobody reads: the queue fills, poses give way, nothing blocks.
  const std::vector<std::uint8_t> pose(245, 7);
  for (int i = 0; i < 200; ++i) port.value()->send(pose, TxClass::kPose);
  close(master);
}

}  // namespace byte_port_test
}  // namespace godwit::link
