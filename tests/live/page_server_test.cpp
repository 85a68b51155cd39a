// Requests that are good, bad or too long, and a port that is taken. How the server holds out against slow and silent
// callers is tested with the page itself (view_test.py).
#include "firmware_app/commands/page_server.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

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

}  // namespace
}  // namespace godwit::app
