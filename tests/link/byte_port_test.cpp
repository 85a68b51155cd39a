// Ports that carry bytes: UDP, a serial line, and one that goes and comes.
#include "firmware_app/link/byte_port.h"

#include <array>
#include <cstdlib>
#include <fcntl.h>
#include <filesystem>
#include <gtest/gtest.h>
#include <pty.h>
#include <string>
#include <unistd.h>
#include <vector>

#include "tests/link/hex.h"
#include "tests/support/temp_folder.h"

namespace godwit::link {
namespace byte_port_test {

/// A serial device that comes and goes, under one name.
class SerialLine {
 public:
  explicit SerialLine(const std::string& folder) : name(folder + "/tty") { plug(); }
  ~SerialLine() { unplug(); }
  void plug() {
    EXPECT_EQ(openpty(&ours_, &theirs_, nullptr, nullptr, nullptr), 0);
    std::filesystem::create_symlink(ttyname(theirs_), name);
  }
  void unplug() {
    std::filesystem::remove(name);
    for (int* fd : {&ours_, &theirs_}) {
      if (*fd >= 0) close(*fd);
      *fd = -1;
    }
  }
  const std::string name;

 private:
  int ours_ = -1, theirs_ = -1;
};

TEST(BytePort, ASerialLineThatGoesIsLeftAloneAndOpenedAgain) {
  const test::TempFolder folder;
  SerialLine line(folder.path());
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
  port.maintain(now + rt::kNsPerSecond);
  EXPECT_FALSE(port.gone());
  EXPECT_TRUE(port.send(message, TxClass::kFlight));
  EXPECT_EQ(port.receive(into), 0u);
  EXPECT_FALSE(port.gone());
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
