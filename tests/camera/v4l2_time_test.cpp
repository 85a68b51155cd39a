// Of which moment a V4L2 picture is: the device's clock, whatever it says, and the middle of the exposure.
#include "tests/camera/v4l2_fixture.h"

namespace godwit::hal::v4l2_time_test {
namespace {

TEST_F(V4l2CameraTest, AClockThatIs29SecondsOffIsReadAndTold) {
  device_.offsets.counter_ns = 29 * rt::kNsPerSecond;
  stamp_ns_ += 29 * rt::kNsPerSecond;  // counter = monotonic + offset
  open();
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  EXPECT_EQ(frame_.t_capture_ns, stamp_ns_ - 29 * rt::kNsPerSecond);
  rt::LogEntry e;
  ASSERT_TRUE(camera_->events()->take(&e));
  EXPECT_STREQ(e.what, "camera clock is not CLOCK_MONOTONIC but");
  EXPECT_DOUBLE_EQ(e.value, -29);
}

TEST_F(V4l2CameraTest, ADeviceTimeThatStandsStillOrJumpsIsBadAtFirstAndThenFollowed) {
  open();
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  stamp_ns_ -= kFrameNs;
  EXPECT_EQ(shoot(), CameraStatus::kBadFrame);
  EXPECT_NE(why_.find("stands still"), std::string::npos);
  stamp_ns_ += kFrameNs;
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  stamp_ns_ += 3600 * rt::kNsPerSecond;
  EXPECT_EQ(shoot(), CameraStatus::kBadFrame);
  EXPECT_NE(why_.find("jumped"), std::string::npos);
  for (int i = 0; i < 5; ++i) {
    ASSERT_EQ(shoot(), CameraStatus::kFrame);
    EXPECT_NEAR(static_cast<double>(frame_.t_capture_ns), static_cast<double>(device_.now_ns), 10e6);
  }
}

TEST_F(V4l2CameraTest, StampsAreMovedToTheMiddleOfTheExposure) {
  device_.controls[V4L2_CID_EXPOSURE_ABSOLUTE] = {"Exposure Time, Absolute", 80};  // 8 ms
  settings_.readout_ns = 10 * rt::kNsPerMs;
  settings_.rolling = true;
  open();
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  EXPECT_EQ(frame_.t_capture_ns, stamp_ns_ - 9 * rt::kNsPerMs);
  ASSERT_EQ(shoot(7, V4L2_BUF_FLAG_TSTAMP_SRC_SOE), CameraStatus::kFrame);
  EXPECT_EQ(frame_.t_capture_ns, stamp_ns_ + 9 * rt::kNsPerMs);
  EXPECT_EQ(middle_of_exposure(0, false, 8, 10, false), -14);
  EXPECT_EQ(middle_of_exposure(0, true, 8, 10, false), 4);
}

TEST_F(V4l2CameraTest, AClockThatIsSetCostsOnePictureAndMovesNoOther) {
  constexpr rt::TimeNs kAhead = 1'700'000'000LL * rt::kNsPerSecond;
  device_.offsets.realtime_ns = -kAhead;
  stamp_ns_ += kAhead;
  open();
  for (int i = 0; i < 5; ++i) {
    ASSERT_EQ(shoot(), CameraStatus::kFrame);
    EXPECT_EQ(frame_.t_capture_ns, stamp_ns_ - kAhead);
  }
  constexpr rt::TimeNs kSetBack = 600 * rt::kNsPerMs;
  device_.spin.lock();
  device_.offsets.realtime_ns += kSetBack;
  device_.spin.unlock();
  stamp_ns_ -= kSetBack;
  EXPECT_EQ(shoot(), CameraStatus::kBadFrame);
  for (int i = 0; i < 5; ++i) {
    ASSERT_EQ(shoot(), CameraStatus::kFrame) << why_;
    EXPECT_EQ(frame_.t_capture_ns, stamp_ns_ - kAhead + kSetBack);
  }
}

}  // namespace
}  // namespace godwit::hal::v4l2_time_test
