#include "firmware_app/link/link_service.h"

#include <atomic>
#include <chrono>
#include <fstream>
#include <gtest/gtest.h>
#include <thread>

#include "hal/machine/machine_id.h"
#include "tests/link/fake_bus.h"

namespace godwit::link {
namespace link_service_test {

LinkSettings settings() {
  LinkSettings s;
  s.can = "multicast:8:127.0.0.1";
  s.link.identity.unique_id = {1};
  return s;
}

TEST(LinkService, RefusalsNameTheReason) {
  LinkSettings nothing;
  nothing.link.identity.unique_id = {1};
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

// A bus that comes up after us, as at boot, grounds nobody: the node says that it has none.
TEST(LinkService, AnInterfaceMissingAtBootIsAStateOfHealth) {
  LinkSettings s = settings();
  s.can = "socketcan:nosuchcan7";
  EXPECT_FALSE(LinkService::open(s).ok()) << "a tool is to say so";
  s.wait_for_bus = true;
  auto opened = LinkService::open(s);
  ASSERT_TRUE(opened.ok()) << opened.error().message;
  LinkService& service = *opened.value();
  ASSERT_FALSE(service.advice().empty());
  EXPECT_NE(service.advice()[0].find("it is looked for"), std::string::npos) << service.advice()[0];
  rt::TimeNs now = rt::kNsPerSecond;
  for (int i = 0; i < 1200; ++i) service.step(now += rt::kNsPerMs);
  LinkStatus status;
  ASSERT_TRUE(service.take_status(&status));
  EXPECT_EQ(status.condition.reasons & kBusTrouble, kBusTrouble);
  EXPECT_EQ(status.bus_state, hal::CanState::kGone);
  EXPECT_EQ(status.bus.sent, 0u);
}

TEST(LinkService, WhatNobodyReadsIsNotAskedFor) {
  LinkSettings s = settings();
  s.link.mavlink.imu_hz = 50;
  const mavlink::EndpointConfig nobody = asked_for(s);
  EXPECT_EQ(nobody.imu_hz + nobody.range_hz + nobody.local_position_hz + nobody.global_position_hz, 0);
  EXPECT_GT(nobody.attitude_hz, 0) << "the link reads it itself";
  s.collect_inputs = true;
  EXPECT_EQ(asked_for(s).imu_hz, 50);
  EXPECT_GT(asked_for(s).range_hz, 0);
}

TEST(LinkService, UniqueIdIsStableAndNeverZero) {
  const auto id = hal::machine_id();
  // Every machine that scripts/setup has seen has one: the package systemd makes it.
  ASSERT_TRUE(id.ok()) << id.error().message;
  EXPECT_EQ(id.value(), hal::machine_id().value());
  EXPECT_NE(id.value(), hal::MachineId{});
  EXPECT_EQ(id.value()[6] >> 4, 4) << "a UUID of version 4, as sd_id128_get_machine_app_specific gives";
  // /etc/machine-id itself is confidential.
  std::string told;
  for (const std::uint8_t byte : id.value())
    told += "0123456789abcdef"[byte >> 4], told += "0123456789abcdef"[byte & 15];
  std::string kept;
  std::ifstream("/etc/machine-id") >> kept;
  EXPECT_NE(told, kept);
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

}  // namespace link_service_test
}  // namespace godwit::link
