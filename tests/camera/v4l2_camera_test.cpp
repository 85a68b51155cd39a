#include "hal/camera/v4l2/v4l2_camera.h"

#include "tests/camera/no_cost.h"
#include "tests/camera/v4l2_fixture.h"

namespace godwit::hal::v4l2_camera_test {
namespace {

TEST_F(V4l2CameraTest, DeliversPicturesWithoutAllocationOrLock) {
  open();
  EXPECT_TRUE(camera_->real_time());
  EXPECT_EQ(camera_->channels(), 1);
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  test::expect_no_heap_and_no_lock(50, [this](int i) {
    ASSERT_EQ(shoot(static_cast<std::uint8_t>(i)), CameraStatus::kFrame);
    ASSERT_EQ(pixels_.front(), i);
    ASSERT_EQ(pixels_.back(), i);
    ASSERT_EQ(frame_.t_capture_ns, stamp_ns_);
    ASSERT_EQ(frame_.sequence, static_cast<std::uint32_t>(i + 1));
  });
}

TEST_F(V4l2CameraTest, AGapInTheDriversSequenceIsCounted) {
  open();
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  sequence_ += 3;
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  EXPECT_EQ(camera_->counters().lost, 3u);
  EXPECT_EQ(frame_.sequence, 4u);
}

TEST_F(V4l2CameraTest, ShortAndMarkedBuffersAreBadPicturesAndTheNextOneIsGood) {
  open();
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  EXPECT_EQ(shoot(7, 0, 64 * 48 - 1), CameraStatus::kBadFrame);
  EXPECT_NE(why_.find("short"), std::string::npos);
  EXPECT_EQ(shoot(7, 0, 1'000'000), CameraStatus::kBadFrame);
  EXPECT_NE(why_.find("more than the buffer holds"), std::string::npos);
  EXPECT_EQ(shoot(7, V4L2_BUF_FLAG_ERROR), CameraStatus::kBadFrame);
  EXPECT_NE(why_.find("damaged"), std::string::npos);
  EXPECT_EQ(shoot(), CameraStatus::kFrame);
  EXPECT_EQ(camera_->counters().damaged, 3u);
}

TEST_F(V4l2CameraTest, WrongSizesFormatsAndRefusalsAreToldInWords) {
  const auto refused = [&](const std::string& words) {
    told_.all.clear();
    open();
    EXPECT_TRUE(told_.has(words)) << words << " is missing in: " << told_.all;
    EXPECT_EQ(next(), CameraStatus::kTimeout);
    camera_.reset();
    EXPECT_EQ(device_.opened, device_.closed);
    EXPECT_EQ(device_.mapped, 0);
  };
  device_.width = 640;
  refused("gives pictures of 640x48, not the 64x48 of the calibration");
  device_.width = 0;
  settings_.format = PixelFormat::kNv12;
  refused("does not offer NV12; it offers GREY");
  settings_.format.reset();
  device_.formats = {V4L2_PIX_FMT_H264};
  refused("it offers H264");
  device_.formats = {V4L2_PIX_FMT_GREY};
  device_.buffer_bytes = 100;
  refused("its buffers hold 100 bytes; a picture has 3072");
  device_.buffer_bytes = 0;
  device_.stride = 10;
  refused("says its rows take 10 bytes");
  device_.stride = 0;
  device_.field = V4L2_FIELD_INTERLACED;
  refused("interlaced");
  device_.field = V4L2_FIELD_NONE;
  device_.stream_on_error = EIO;
  refused("does not begin to stream: Input/output error");
  device_.stream_on_error = 0;
  device_.request_error = EBUSY;
  refused("another program uses it");
  device_.request_error = 0;
  device_.capabilities = V4L2_CAP_META_CAPTURE;
  refused("gives no pictures");
  device_.capabilities = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
  settings_.controls = {{"emitter", 0}};
  refused("has no control emitter");
}

TEST_F(V4l2CameraTest, AControlOfAVendorsOwnIsSetInItsExtensionUnit) {
  device_.extension_units = {{{3, 2}, {1}}, {{3, 4}, {150, 0}}, {{3, 9}, std::vector<std::uint8_t>(24)}};
  settings_.controls = {{"uvc:3:2", 0}, {"uvc:3:4", 0x168}};
  open();
  EXPECT_EQ(shoot(), CameraStatus::kFrame) << told_.all;
  EXPECT_EQ((device_.extension_units[{3, 2}]), std::vector<std::uint8_t>({0}));
  EXPECT_EQ((device_.extension_units[{3, 4}]), std::vector<std::uint8_t>({0x68, 0x01}));
  const auto refused = [&](const char* name, std::int64_t value, const std::string& words) {
    told_.all.clear();
    settings_.controls = {{name, value}};
    open();
    EXPECT_TRUE(told_.has(words)) << name << ": " << words << " is missing in: " << told_.all;
    EXPECT_EQ(next(), CameraStatus::kTimeout);
  };
  refused("uvc:4:2", 0, "no such extension unit");
  refused("uvc:3:2", 256, "more than its 1 bytes hold");
  refused("uvc:3:2", -1, "more than its 1 bytes hold");
  refused("uvc:3:9", 0, "it has 24 bytes, not 1 to 8");
  for (const char* name : {"uvc:", "uvc:3", "uvc:3:2:1", "uvc:3:2x", "uvc:300:2", "uvc:-3:2"}) {
    refused(name, 0, "UNIT:SELECTOR is allowed");
  }
  device_.stubborn = true;
  refused("uvc:3:2", 1, "the device did not take it");
  device_.extension_units.clear();
  refused("uvc:3:2", 0, "no UVC device");
}

TEST_F(V4l2CameraTest, ADeviceThatGoesComesBack) {
  open();
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  device_.there = false;
  EXPECT_EQ(next(), CameraStatus::kTimeout);
  EXPECT_FALSE(camera_->streaming());
  until([&] { return told_.has("cannot be opened"); });
  device_.there = true;
  const int tried = device_.tried;
  until([&] { return camera_->streaming(); });
  // Within two seconds, were the machine not busy: by the second try, as one may have been under way.
  EXPECT_LE(device_.tried, tried + 2);
  static_assert(2 * V4l2Camera::kRetryNs <= 2 * rt::kNsPerSecond);
  EXPECT_EQ(shoot(9), CameraStatus::kFrame);
  EXPECT_EQ(pixels_.front(), 9);
  EXPECT_EQ(frame_.sequence, 1u);
  EXPECT_EQ(camera_->counters().gone, 1u);
  EXPECT_EQ(camera_->counters().back, 1u);
  EXPECT_EQ(device_.opened, device_.closed + 1);
  rt::LogEntry e;
  ASSERT_TRUE(camera_->events()->take(&e));
  EXPECT_STREQ(e.what, "camera device lost");
  ASSERT_TRUE(camera_->events()->take(&e));
  EXPECT_STREQ(e.what, "camera device is back");
}

TEST_F(V4l2CameraTest, TheFrameIntervalWantedReachesTheDeviceAndAnotherOneIsTold) {
  settings_.fps = 25;
  device_.takes_fps = true;
  open();
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  EXPECT_EQ(device_.asked_interval.denominator, 25u * device_.asked_interval.numerator);
  EXPECT_FALSE(told_.has("pictures a second"));
  camera_.reset();
  device_.takes_fps = false;
  device_.fps = 30;
  open();
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  EXPECT_TRUE(told_.has("/dev/video0: gives 30.00 pictures a second, not 25.00")) << told_.all;
  camera_.reset();
  device_.tells_fps = false;
  open();
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  EXPECT_TRUE(told_.has("/dev/video0: its frame rate cannot be set")) << told_.all;
}

TEST_F(V4l2CameraTest, ADeviceThatIsNotThereAtTheStartIsLookedFor) {
  device_.there = false;
  open();
  EXPECT_EQ(next(), CameraStatus::kTimeout);
  device_.there = true;
  until([&] { return camera_->streaming(); });
  EXPECT_EQ(shoot(), CameraStatus::kFrame);
}

TEST_F(V4l2CameraTest, AStalledStreamIsStartedAnew) {
  open();
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  for (int i = 0; i < 11; ++i) EXPECT_EQ(next(100 * rt::kNsPerMs), CameraStatus::kTimeout);
  EXPECT_EQ(camera_->counters().stalls, 1u);
  until([&] { return camera_->streaming(); });
  EXPECT_EQ(shoot(), CameraStatus::kFrame);
}

TEST_F(V4l2CameraTest, WaitsNoLongerThanItMayWhenTheDeviceComesMeanwhile) {
  device_.there = false;
  settings_.stall_ns = 3600 * rt::kNsPerSecond;
  open();
  std::thread plugs([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(300));
    device_.there = true;
  });
  constexpr rt::TimeNs kMayWaitNs = 60 * rt::kNsPerSecond;
  EXPECT_EQ(next(kMayWaitNs), CameraStatus::kTimeout);
  plugs.join();
  EXPECT_TRUE(camera_->streaming());
  EXPECT_LT(device_.longest_wait_ns, kMayWaitNs - 250 * rt::kNsPerMs);
}

}  // namespace
}  // namespace godwit::hal::v4l2_camera_test
