// The socket under readers that are quick, slow, gone or too many, and where something lies in its place.
#include "firmware_app/output/live_server.h"

#include <atomic>
#include <filesystem>
#include <fstream>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>
#include <vector>

#include "hal/rt/wake_up.h"
#include "tests/support/temp_folder.h"

namespace godwit::app {
namespace {
namespace fs = std::filesystem;
using testing::HasSubstr;

LiveServerOptions options(const std::string& socket, std::atomic<int>* asked = nullptr, std::size_t bytes = 20) {
  LiveServerOptions o;
  o.socket = socket;
  o.interval_ns = 5 * rt::kNsPerMs;
  o.line = [asked, bytes] {
    if (asked != nullptr) ++*asked;
    return std::string(bytes, 'x');
  };
  return o;
}

/// A line that the socket tells, without its end; what came before the other end went.
std::string line_of(int fd) {
  std::string out;
  char c = 0;
  pollfd waiting{fd, POLLIN, 0};
  while (poll(&waiting, 1, 20'000) > 0 && recv(fd, &c, 1, 0) == 1 && c != '\n') out += c;
  return out;
}

TEST(LiveServer, TellsEachReaderAndAsksNobodyWhileNoneIsThere) {
  const test::TempFolder folder;
  std::atomic<int> asked{0};
  auto server = LiveServer::start(options(folder / "live", &asked));
  ASSERT_TRUE(server.ok()) << server.error().message;
  rt::sleep_until_ns(rt::monotonic_now_ns() + 100 * rt::kNsPerMs);
  EXPECT_EQ(asked, 0) << "what nobody reads costs nothing";
  struct stat about {};
  ASSERT_EQ(stat((folder / "live").c_str(), &about), 0);
  EXPECT_EQ(about.st_mode & 0777, 0660u);
  const auto one = connect_live(folder / "live"), two = connect_live(folder / "live");
  ASSERT_TRUE(one.ok() && two.ok());
  for (int i = 0; i < 3; ++i) {
    EXPECT_EQ(line_of(one.value()), std::string(20, 'x'));
    EXPECT_EQ(line_of(two.value()), std::string(20, 'x'));
  }
  close(one.value());
  EXPECT_EQ(line_of(two.value()), std::string(20, 'x')) << "who goes takes nobody with him";
  close(two.value());
  server.value().reset();
  EXPECT_FALSE(fs::exists(folder / "live"));
  const auto gone = connect_live(folder / "live");
  ASSERT_FALSE(gone.ok());
  EXPECT_THAT(gone.error().message, HasSubstr("no godwitd serves it"));
}

TEST(LiveServer, AReaderThatDoesNotReadHoldsNobodyUp) {
  const test::TempFolder folder;
  std::atomic<int> asked{0};
  auto server = LiveServer::start(options(folder / "live", &asked, 50'000));
  ASSERT_TRUE(server.ok()) << server.error().message;
  const auto lazy = connect_live(folder / "live"), quick = connect_live(folder / "live");
  ASSERT_TRUE(lazy.ok() && quick.ok());
  for (int i = 0; i < 50; ++i) ASSERT_EQ(line_of(quick.value()).size(), 50'000u);
  EXPECT_EQ(line_of(lazy.value()).size(), 50'000u) << "what it gets is whole all the same";
  close(lazy.value());
  close(quick.value());
}

TEST(LiveServer, OnlyWhoAsksForItSeesTheView) {
  const test::TempFolder folder;
  std::atomic<int> viewed{0};
  LiveServerOptions o = options(folder / "live");
  o.view = [&viewed](std::string* out) {
    ++viewed;
    *out += std::string(400'000, 'p') + "\n";
  };
  auto server = LiveServer::start(o);
  ASSERT_TRUE(server.ok()) << server.error().message;
  const auto plain = connect_live(folder / "live"), quick = connect_live(folder / "live");
  for (int i = 0; i < 5; ++i) ASSERT_EQ(line_of(plain.value()), std::string(20, 'x'));
  EXPECT_EQ(viewed, 0) << "nobody asked for it";
  // In two pieces, with another word before.
  ASSERT_EQ(send(quick.value(), "what?\nvi", 8, 0), 8);
  ASSERT_EQ(send(quick.value(), "ew\n", 3, 0), 3);
  int whole = 0;
  for (int i = 0; i < 100 && whole < 3; ++i) whole += line_of(quick.value()).size() == 400'000 ? 1 : 0;
  EXPECT_EQ(whole, 3) << "larger than the socket's buffer, and whole";
  // One who asks and does not read holds nobody up.
  const auto lazy = connect_live(folder / "live");
  ASSERT_EQ(send(lazy.value(), kAskView, 5, 0), 5);
  for (int i = 0; i < 20; ++i) ASSERT_EQ(line_of(plain.value()), std::string(20, 'x'));
  close(quick.value());
  close(lazy.value());
  EXPECT_EQ(line_of(plain.value()), std::string(20, 'x'));
  close(plain.value());
}

TEST(LiveServer, WhoSaysNothingMoreMayReadOn) {
  const test::TempFolder folder;
  auto server = LiveServer::start(options(folder / "live"));
  ASSERT_TRUE(server.ok()) << server.error().message;
  const auto reader = connect_live(folder / "live");
  const std::string noise(100'000, 'n');
  ASSERT_GT(send(reader.value(), noise.data(), noise.size(), MSG_DONTWAIT), 0);
  shutdown(reader.value(), SHUT_WR);
  for (int i = 0; i < 5; ++i) EXPECT_EQ(line_of(reader.value()), std::string(20, 'x'));
  close(reader.value());
}

TEST(LiveServer, SoManyReadersAndNoMore) {
  const test::TempFolder folder;
  LiveServerOptions o = options(folder / "live");
  o.readers = 2;
  auto server = LiveServer::start(o);
  ASSERT_TRUE(server.ok());
  const auto one = connect_live(folder / "live"), two = connect_live(folder / "live");
  ASSERT_NE(line_of(one.value()), "");
  ASSERT_NE(line_of(two.value()), "");
  const auto three = connect_live(folder / "live");
  ASSERT_TRUE(three.ok());
  EXPECT_EQ(line_of(three.value()), "{\"error\":\"2 others read already\"}");
  EXPECT_EQ(line_of(three.value()), "") << "and is let go";
  for (const auto& reader : {one.value(), two.value(), three.value()}) close(reader);
}

TEST(LiveServer, WhatADeadProgramLeftIsReplacedAndALivingOneIsNot) {
  const test::TempFolder folder;
  const std::string path = folder / "live";
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  path.copy(address.sun_path, sizeof address.sun_path - 1);
  const int dead = socket(AF_UNIX, SOCK_STREAM, 0);
  ASSERT_EQ(bind(dead, reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
  close(dead);
  ASSERT_TRUE(fs::exists(path));
  auto server = LiveServer::start(options(path));
  ASSERT_TRUE(server.ok()) << server.error().message;
  const auto second = LiveServer::start(options(path));
  ASSERT_FALSE(second.ok());
  EXPECT_THAT(second.error().message, HasSubstr("another program serves it"));
  const auto reader = connect_live(path);
  ASSERT_TRUE(reader.ok());
  EXPECT_NE(line_of(reader.value()), "") << "the first one's socket is still there";
  close(reader.value());
}

// A connection to a program that takes none waits for ever, and so would its successor's start.
TEST(LiveServer, OneThatHangsHoldsNobodyUpAndKeepsItsSocket) {
  const test::TempFolder folder;
  const std::string path = folder / "live";
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  path.copy(address.sun_path, sizeof address.sun_path - 1);
  const int hanging = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  ASSERT_EQ(bind(hanging, reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
  ASSERT_EQ(listen(hanging, 0), 0);
  std::vector<int> waiting;
  for (auto one = connect_live(path); one.ok() && waiting.size() < 100; one = connect_live(path))
    waiting.push_back(one.value());
  EXPECT_LT(waiting.size(), 100u);
  EXPECT_THAT(connect_live(path).error().message, HasSubstr("takes nobody"));
  const auto second = LiveServer::start(options(path));
  ASSERT_FALSE(second.ok());
  EXPECT_THAT(second.error().message, HasSubstr("another program serves it"));
  EXPECT_TRUE(fs::exists(path));
  for (const int fd : waiting) close(fd);
  close(hanging);
}

TEST(LiveServer, AThreadThatHangsIsNamedAndKeepsNoEndAway) {
  const test::TempFolder folder;
  std::atomic<bool> hangs{true};
  std::string abandoned;
  LiveServerOptions o = options(folder / "live");
  o.line = [&] {
    while (hangs) rt::sleep_until_ns(rt::monotonic_now_ns() + rt::kNsPerMs);
    return std::string("at last");
  };
  o.abandon = [&](const char* thread) {
    abandoned = thread;  // a program would end here
    hangs = false;
  };
  auto server = LiveServer::start(o);
  ASSERT_TRUE(server.ok()) << server.error().message;
  const auto reader = connect_live(folder / "live");
  ASSERT_TRUE(reader.ok());
  rt::sleep_until_ns(rt::monotonic_now_ns() + 200 * rt::kNsPerMs);
  server.value().reset();
  EXPECT_EQ(abandoned, "gw-live");
  close(reader.value());
}

TEST(LiveServer, WhatIsNoSocketIsLeftAlone) {
  const test::TempFolder folder;
  std::ofstream(folder / "live") << "precious";
  const auto server = LiveServer::start(options(folder / "live"));
  ASSERT_FALSE(server.ok());
  EXPECT_THAT(server.error().message, HasSubstr("is there, and no socket"));
  EXPECT_EQ(test::read_file(folder / "live"), "precious");
  EXPECT_FALSE(LiveServer::start(options(folder / "no/such")).ok());
  EXPECT_THAT(LiveServer::start(options(std::string(200, 'x'))).error().message, HasSubstr("1 to 107 bytes"));
}

}  // namespace
}  // namespace godwit::app
