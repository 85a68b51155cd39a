// Requests that are good, bad or too long, and a port that is taken. How the server holds out against slow and silent
// callers is tested with the page itself (view_test.py).
#include "firmware_app/commands/page_server.h"

#include <arpa/inet.h>
#include <array>
#include <atomic>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <thread>
#include <unistd.h>
#include <vector>

namespace godwit::app {
namespace {

using testing::HasSubstr;

PageRequest read(const std::string& head, bool local = true) {
  return read_request(head, local);
}

TEST(PageServer, ReadsWhatIsAskedFor) {
  const PageRequest page = read("GET /status?since=3 HTTP/1.1\r\nAccept: */*\r\nHost: localhost:8712");
  EXPECT_EQ(page.refused, 0) << page.because;
  EXPECT_EQ(page.path, "/status");
  EXPECT_FALSE(page.head);
  EXPECT_TRUE(read("HEAD / HTTP/1.0\r\nhost:127.0.0.1").head);
}

TEST(PageServer, RefusesWhatIsNone) {
  const std::string host = "\r\nHost: localhost";
  for (const char* first :
       {"", " ", "GET", "GET /", "GET / FTP/1.1", "GET  HTTP/1.1", "\x16\x03\x01", "GET http://x/ HTTP/1.1"}) {
    EXPECT_EQ(read(first + host).refused, 400) << first;
  }
  for (const char* method : {"POST", "PUT", "DELETE", "OPTIONS", "get"}) {
    EXPECT_EQ(read(method + (" / HTTP/1.1" + host)).refused, 405) << method;
  }
  EXPECT_EQ(read("GET / HTTP/1.1").refused, 400) << "no host";
  EXPECT_EQ(read("GET / HTTP/1.1" + host + host).refused, 400) << "two hosts";
}

TEST(PageServer, OfThisMachineAloneOnlyByANameOfThisMachine) {
  for (const char* name :
       {"localhost", "LOCALHOST:1", "127.0.0.1", "127.0.0.1:8712", "127.8.1.2", "[::1]", "[::1]:8712"}) {
    EXPECT_EQ(read(std::string("GET / HTTP/1.1\r\nHost: ") + name).refused, 0) << name;
  }
  for (const char* name :
       {"", "evil.example", "127.evil.example", "localhost.evil.example", "localhost:x", "10.0.0.1:80", "::1"}) {
    const std::string head = std::string("GET / HTTP/1.1\r\nHost: ") + name;
    EXPECT_EQ(read(head).refused, 403) << name;
    EXPECT_EQ(read(head, false).refused, 0) << "an address that all may reach has any name: " << name;
  }
}

TEST(PageServer, SaysWhatIsWrongWithAnAddressOrAPort) {
  const auto answer = [](const std::string&) { return PageAnswer{}; };
  const auto first = PageServer::open("127.0.0.1", 0, answer);
  ASSERT_TRUE(first.ok()) << first.error().message;
  EXPECT_TRUE(first.value()->local());
  ASSERT_GT(first.value()->port(), 0);
  const auto second = PageServer::open("127.0.0.1", first.value()->port(), answer);
  ASSERT_FALSE(second.ok());
  EXPECT_THAT(second.error().message, HasSubstr("is taken"));
  EXPECT_THAT(PageServer::open("localhost.example", 0, answer).error().message, HasSubstr("is no address"));
  EXPECT_THAT(PageServer::open("192.0.2.1", 0, answer).error().message, HasSubstr("is no address of this machine"));
  const auto all = PageServer::open("0.0.0.0", 0, answer);
  ASSERT_TRUE(all.ok());
  EXPECT_FALSE(all.value()->local());
}

/// A connection to the server; -1: none.
int call(int port) {
  const int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_port = htons(static_cast<std::uint16_t>(port));
  to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  if (fd >= 0 && connect(fd, reinterpret_cast<const sockaddr*>(&to), sizeof to) == 0) return fd;
  close(fd);
  return -1;
}

void ask(int fd) {
  const std::string request = "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n";
  ASSERT_EQ(send(fd, request.data(), request.size(), MSG_NOSIGNAL), static_cast<ssize_t>(request.size()));
}

// More callers than it has at a time, half of whom say nothing, and half ask for much and take none of it.
TEST(PageServer, WhoSaysOrTakesNothingIsLetGoForOthers) {
  const auto server = PageServer::open("127.0.0.1", 0, [](const std::string&) {
    return PageAnswer{200, "text/plain", std::string(16 << 20, 'x')};
  });
  ASSERT_TRUE(server.ok()) << server.error().message;
  std::atomic<bool> stop{false};
  std::thread serving([&] { server.value()->run(stop); });
  std::vector<int> idle;
  for (int i = 0; i < 40; ++i) {
    idle.push_back(call(server.value()->port()));
    ASSERT_GE(idle.back(), 0);
    if (i % 2 == 0) ask(idle.back());
  }
  const int late = call(server.value()->port());
  ASSERT_GE(late, 0);
  ask(late);
  const timeval patience{60, 0};  // it waits for five seconds, twice: the first 32 are let go, then the other eight
  setsockopt(late, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
  std::array<char, 15> answer{};
  EXPECT_EQ(recv(late, answer.data(), answer.size(), MSG_WAITALL), static_cast<ssize_t>(answer.size()));
  EXPECT_EQ(std::string(answer.data(), answer.size()), "HTTP/1.1 200 OK");
  stop.store(true);
  serving.join();
  for (const int fd : idle) close(fd);
  close(late);
}

}  // namespace
}  // namespace godwit::app
