#include "firmware_app/link/link_service.h"

#include <atomic>
#include <chrono>
#include <gtest/gtest.h>
#include <thread>

#include "tests/link/fake_bus.h"

namespace godwit::link {
namespace {

LinkSettings settings() {
  LinkSettings s;
  s.can = "multicast:8:127.0.0.1";
  s.link.identity.unique_id = dronecan::unique_id_from("test");
  return s;
}

TEST(LinkService, RefusalsNameTheReason) {
  LinkSettings nothing;
  nothing.link.identity.unique_id = dronecan::unique_id_from("test");
  EXPECT_FALSE(LinkService::open(nothing).ok());
  LinkSettings s = settings();
  s.can = "multicast:77";
  auto bad = LinkService::open(s);
  ASSERT_FALSE(bad.ok());
  EXPECT_NE(bad.error().message.find("multicast:77"), std::string::npos);
  s = settings();
  s.mavlink = "udp:nowhere:1";
  bad = LinkService::open(s);
  ASSERT_FALSE(bad.ok());
  EXPECT_NE(bad.error().message.find("nowhere"), std::string::npos);
}

TEST(LinkService, AStateFolderThatIsNotThereIsRefused) {
  LinkSettings s = settings();
  s.state_folder = "/no/such/folder";
  const auto bad = LinkService::open(s);
  ASSERT_FALSE(bad.ok());
  EXPECT_NE(bad.error().message.find("/no/such/folder"), std::string::npos);
}

TEST(LinkService, UniqueIdIsStableAndNeverZero) {
  EXPECT_EQ(dronecan::unique_id_from("a"), dronecan::unique_id_from("a"));
  EXPECT_NE(dronecan::unique_id_from("a"), dronecan::unique_id_from("b"));
  EXPECT_NE(dronecan::unique_id_from(""), dronecan::UniqueId{});
}

// Two threads on a real bus: poses published here are sent there.
TEST(LinkService, PosesCrossThreadsToTheBus) {
  auto opened = LinkService::open(settings());
  ASSERT_TRUE(opened.ok()) << opened.error().message;
  const std::unique_ptr<LinkService> service = std::move(opened).value();
  std::atomic<bool> stop{false};
  std::thread link_thread([&] {
    while (!stop) {
      service->wait(5 * rt::kNsPerMs);
      service->step(rt::monotonic_now_ns());
    }
  });
  LinkStatus status;
  for (int i = 0; i < 2000 && status.odometry_sent < 10; ++i) {
    service->publish(good_pose(rt::monotonic_now_ns() - 5 * rt::kNsPerMs));
    service->publish(SystemHealth{});
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    service->take_status(&status);
  }
  stop = true;
  link_thread.join();
  EXPECT_GE(status.odometry_sent, 10U);
  EXPECT_GT(status.quality, 0);
  EXPECT_EQ(status.bus_state, hal::CanState::kActive);
  EXPECT_GE(status.bus.sent, 10U * 40U);
}

}  // namespace
}  // namespace godwit::link
