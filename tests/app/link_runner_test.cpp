#include "firmware_app/autopilot/link_runner.h"

#include <gtest/gtest.h>
#include <mutex>
#include <thread>
#include <unistd.h>

#include "hal/rt/process_end.h"
#include "hal/rt/wake_up.h"
#include "tests/link/serial_line.h"
#include "tests/support/standing_thread.h"
#include "tests/support/temp_folder.h"

namespace godwit::app {
namespace {

/// A link on a bus of its own, and this thread in the tracker's place.
class LinkRunnerTest : public ::testing::Test {
 protected:
  void SetUp() override {
    LinkRunnerOptions options;
    options.settings.can = "multicast:7:127.0.0.1";
    // ctest runs these tests beside each other, and each is one node on the same bus: two of one id would be an error.
    options.settings.link.parameters[static_cast<std::size_t>(link::Parameter::kNodeId)] = 20 + getpid() % 100;
    options.settings.link.identity.unique_id = {1, 2, 3};
    options.heartbeats = &heartbeats_;
    options.settings.link.heartbeats = &heartbeats_;
    options.log = [this](LinkLogLevel, const std::string&) {
      while (log_hangs_.load()) rt::sleep_until_ns(rt::monotonic_now_ns() + rt::kNsPerMs);
    };
    options.report_ns = 100 * rt::kNsPerMs;
    options.abandon = [this](const char* thread) {
      abandoned_ = thread;  // a program would end here
      log_hangs_.store(false);
      test::let_thread_go();
    };
    auto started = LinkRunner::start(options, user_stop_);
    ASSERT_TRUE(started.ok()) << started.error().message;
    runner_ = std::move(started).value();
    for (int i = 0; i < 10; ++i) frame();
  }
  void frame() {
    FrameRecord record;
    record.state = vo::State::kInitialising;
    record.t_capture_ns = rt::monotonic_now_ns() - rt::kNsPerMs;
    runner_->frame_done(record);
    rt::sleep_until_ns(rt::monotonic_now_ns() + 10 * rt::kNsPerMs);
  }
  void silence(rt::TimeNs ns, bool tracker_lives) {
    const rt::TimeNs begin = rt::monotonic_now_ns();
    while (rt::monotonic_now_ns() - begin < ns) {
      rt::sleep_until_ns(rt::monotonic_now_ns() + 100 * rt::kNsPerMs);
      if (tracker_lives) runner_->no_picture(rt::monotonic_now_ns(), begin);
    }
  }
  link::dronecan::NodeCondition last_condition() { return runner_->finish().condition; }

  std::atomic<bool> user_stop_{false};
  std::atomic<bool> log_hangs_{false};
  std::string abandoned_;
  rt::Heartbeats heartbeats_;
  std::unique_ptr<LinkRunner> runner_;
};

TEST_F(LinkRunnerTest, ASilentCameraIsNamed) {
  silence(rt::kNsPerSecond, true);
  const auto condition = last_condition();
  EXPECT_EQ(condition.health, link::dronecan::NodeHealth::kError);
  EXPECT_EQ(condition.reasons & (link::kPoseStalled | link::kCameraFailed | link::kProcessFailed),
            link::kPoseStalled | link::kCameraFailed);
}

TEST_F(LinkRunnerTest, ATrackerThatHangsIsNamed) {
  silence(rt::kNsPerSecond, false);
  const auto condition = last_condition();
  EXPECT_EQ(condition.health, link::dronecan::NodeHealth::kError);
  EXPECT_EQ(condition.reasons & (link::kPoseStalled | link::kCameraFailed | link::kProcessFailed),
            link::kPoseStalled | link::kProcessFailed);
}

TEST_F(LinkRunnerTest, SensorAndDetectorAreNamedAndAreNoErrorOfTheirs) {
  runner_->imu_silent(true);
  runner_->detector_failed(true);
  for (int i = 0; i < 40; ++i) frame();
  const auto condition = last_condition();
  EXPECT_EQ(condition.reasons & (link::kImuFailed | link::kDetectorFailed), link::kImuFailed | link::kDetectorFailed);
  EXPECT_EQ(condition.reasons & link::kPoseStalled, 0);
  EXPECT_EQ(condition.health, link::dronecan::NodeHealth::kOk) << condition.reasons;
}

TEST_F(LinkRunnerTest, AThreadThatFellSilentIsAFailureOfTheProcess) {
  rt::Pulse mapper = heartbeats_.watch("gw-mapper", 100 * rt::kNsPerMs);
  for (int i = 0; i < 40; ++i) frame();
  const auto condition = last_condition();
  EXPECT_EQ(condition.reasons & (link::kProcessFailed | link::kPoseStalled), link::kProcessFailed);
  EXPECT_EQ(condition.health, link::dronecan::NodeHealth::kError);
  mapper.end();
}

TEST_F(LinkRunnerTest, AKeeperThatHangsIsNamedAndKeepsNoEndAway) {
  log_hangs_.store(true);
  const rt::TimeNs begin = rt::monotonic_now_ns();
  while (heartbeats_.silent(rt::monotonic_now_ns()).name == nullptr &&
         rt::monotonic_now_ns() - begin < 20 * rt::kNsPerSecond) {
    frame();
  }
  EXPECT_STREQ(heartbeats_.silent(rt::monotonic_now_ns()).name, "gw-link-keep");
  user_stop_.store(true);
  while (!runner_->stop().load() && rt::monotonic_now_ns() - begin < 30 * rt::kNsPerSecond) frame();
  EXPECT_TRUE(runner_->stop().load());
  const auto condition = last_condition();
  EXPECT_EQ(abandoned_, "gw-link-keep");
  EXPECT_EQ(condition.reasons & link::kProcessFailed, link::kProcessFailed);
}

// 2 s are left of 3; its own patience is 4.
TEST_F(LinkRunnerTest, ItWaitsNoLongerThanUntilTheProcessIsToEnd) {
  rt::begin_process_end();
  rt::sleep_until_ns(rt::monotonic_now_ns() + rt::kNsPerSecond);
  test::stop_thread("gw-link");
  std::atomic<bool> over{false};
  std::thread at_last([&] {
    rt::sleep_until_ns(rt::process_end_ns());
    // Turns, and not a time: on a machine that is busy they last longer, as finish()'s own do.
    for (int turn = 0; turn < 1500 && !over.load(); ++turn) rt::sleep_until_ns(rt::monotonic_now_ns() + rt::kNsPerMs);
    test::let_thread_go();
  });
  runner_->finish();
  over.store(true);
  at_last.join();
  EXPECT_GE(rt::monotonic_now_ns(), rt::process_end_ns());
  rt::forget_process_end();
  EXPECT_EQ(abandoned_, "gw-link");
}

TEST_F(LinkRunnerTest, ARepeatedPictureIsNotPublishedAndCounted) {
  const auto publish = [this](bool repeated) {
    FrameRecord record;
    record.state = vo::State::kTracking;
    record.repeated = repeated;
    record.has_pose = !repeated;
    record.t_capture_ns = rt::monotonic_now_ns() - rt::kNsPerMs;
    record.q_world_cam = {0, 0, 0, 1};
    runner_->frame_done(record);
    rt::sleep_until_ns(rt::monotonic_now_ns() + 10 * rt::kNsPerMs);
  };
  publish(false);
  for (int i = 0; i < 5; ++i) publish(true);
  const link::LinkStatus& status = runner_->finish();
  EXPECT_EQ(status.pictures_repeated, 5u);
  bool told = false;
  for (const std::string& line : link_report(status)) told = told || line.starts_with("5 pictures were the one before");
  EXPECT_TRUE(told);
}

TEST_F(LinkRunnerTest, ALinkThreadThatHangsIsNamedAndKeepsNoEndAway) {
  test::stop_thread("gw-link");
  const rt::TimeNs begin = rt::monotonic_now_ns();
  while (heartbeats_.silent(rt::monotonic_now_ns()).name == nullptr &&
         rt::monotonic_now_ns() - begin < 20 * rt::kNsPerSecond) {
    frame();
  }
  EXPECT_STREQ(heartbeats_.silent(rt::monotonic_now_ns()).name, "gw-link");
  runner_->finish();
  EXPECT_EQ(abandoned_, "gw-link");
}

TEST(LinkRunner, APortThatIsNotThereAtBootOrGoesIsTold) {
  const test::TempFolder folder;
  test::SerialLine line(folder / "tty");
  line.unplug();
  std::mutex mutex;
  std::string said;
  LinkRunnerOptions options;
  options.settings.mavlink = "serial:" + line.name + ":115200";
  options.settings.wait_for_bus = true;
  options.settings.link.identity.unique_id = {1, 2, 3};
  options.log = [&](LinkLogLevel, const std::string& text) {
    const std::lock_guard<std::mutex> lock(mutex);
    said += text + "\n";
  };
  const std::atomic<bool> stop{false};
  auto started = LinkRunner::start(options, stop);
  ASSERT_TRUE(started.ok()) << started.error().message;
  const auto hears = [&](const std::string& words) {
    const rt::TimeNs give_up_ns = rt::monotonic_now_ns() + 30 * rt::kNsPerSecond;
    while (rt::monotonic_now_ns() < give_up_ns) {
      {
        const std::lock_guard<std::mutex> lock(mutex);
        const std::size_t at = said.find(words);
        if (at != std::string::npos) return said.erase(0, at + words.size()), true;
      }
      rt::sleep_until_ns(rt::monotonic_now_ns() + 10 * rt::kNsPerMs);
    }
    return false;
  };
  EXPECT_TRUE(hears("the MAVLink port is not there; it is looked for"));
  line.plug();
  EXPECT_TRUE(hears("the MAVLink port is there"));
  line.unplug();
  EXPECT_TRUE(hears("the MAVLink port is not there; it is looked for"));
}

TEST(LinkReport, WhereThereIsNoBusNothingIsSaidOfOne) {
  link::LinkStatus status;
  status.tx.refused = 3;
  const auto said = [&] {
    std::string out;
    for (const std::string& line : link_report(status)) out += line + "\n";
    return out;
  };
  EXPECT_NE(said().find("sending: 3 messages dropped whole"), std::string::npos);
  EXPECT_EQ(said().find("bus"), std::string::npos) << said();
  status.has_bus = true;
  EXPECT_NE(said().find("bus load"), std::string::npos);
  EXPECT_NE(said().find("bus-off 0 times"), std::string::npos);
}

TEST_F(LinkRunnerTest, AfterASilenceTheReasonsGo) {
  silence(rt::kNsPerSecond, true);
  for (int i = 0; i < 40; ++i) frame();
  EXPECT_EQ(last_condition().reasons & (link::kCameraFailed | link::kProcessFailed), 0);
}

}  // namespace
}  // namespace godwit::app
