#include "firmware_app/autopilot/link_runner.h"

#include <gtest/gtest.h>

#include "hal/rt/wake_up.h"

namespace godwit::app {
namespace {

/// A link on a bus of its own, and this thread in the tracker's place.
class LinkRunnerTest : public ::testing::Test {
 protected:
  void SetUp() override {
    LinkRunnerOptions options;
    options.settings.can = "multicast:7:127.0.0.1";
    options.settings.link.identity.unique_id = link::dronecan::unique_id_from("link_runner_test");
    auto started = LinkRunner::start(options, user_stop_);
    ASSERT_TRUE(started.ok()) << started.error().message;
    runner_ = std::move(started).value();
    for (int i = 0; i < 10; ++i) frame();
  }
  void frame() {
    FrameRecord record;
    record.state = "INITIALISING";
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
  EXPECT_EQ(condition.health, link::dronecan::NodeHealth::kOk);
}

TEST_F(LinkRunnerTest, AfterASilenceTheReasonsGo) {
  silence(rt::kNsPerSecond, true);
  for (int i = 0; i < 40; ++i) frame();
  EXPECT_EQ(last_condition().reasons & (link::kCameraFailed | link::kProcessFailed), 0);
}

}  // namespace
}  // namespace godwit::app
