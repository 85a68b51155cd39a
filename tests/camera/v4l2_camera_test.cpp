#include "hal/camera/v4l2/v4l2_camera.h"

#include <gtest/gtest.h>
#include <mutex>
#include <opencv2/imgcodecs.hpp>
#include <thread>

#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"
#include "tests/camera/fake_video.h"
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#include "hal/rt/lock_hook.h"
#endif

namespace godwit::hal {
namespace {

using test::FakeDevice;
using test::FakeVideo;

constexpr rt::TimeNs kFrameNs = 33 * rt::kNsPerMs;

/// What the camera told, from its own thread.
struct Told {
  std::mutex mutex;
  std::string all;
  bool has(const std::string& words) {
    const std::lock_guard<std::mutex> lock(mutex);
    return all.find(words) != std::string::npos;
  }
};

class V4l2CameraTest : public ::testing::Test {
 protected:
  void open() {
    settings_.device = settings_.device.empty() ? "/dev/video0" : settings_.device;
    if (settings_.width == 0) settings_.width = 64;
    if (settings_.height == 0) settings_.height = 48;
    auto camera = V4l2Camera::open(std::make_unique<FakeVideo>(&device_), settings_, [this](const std::string& text) {
      const std::lock_guard<std::mutex> lock(told_.mutex);
      told_.all += text + "\n";
    });
    ASSERT_TRUE(camera.ok());
    camera_ = std::move(camera).value();
    pixels_.assign(static_cast<std::size_t>(settings_.width * settings_.height), 0);
    bgr_.assign(pixels_.size() * 3, 0);
    why_.reserve(256);
  }
  rt::MutableImageView grey() { return {pixels_.data(), settings_.width, settings_.height, settings_.width}; }
  CameraStatus next(rt::TimeNs timeout_ns = rt::kNsPerMs) {
    return camera_->next(grey(), bgr_.data(), timeout_ns, &frame_, &why_);
  }
  /// One picture taken and read a little later.
  CameraStatus shoot(std::uint8_t value = 7, std::uint32_t flags = 0, std::int64_t bytes = -1) {
    device_.now_ns += kFrameNs;
    stamp_ns_ += kFrameNs;
    EXPECT_TRUE(device_.shoot(value, stamp_ns_, sequence_++, flags, bytes));
    return next();
  }
  /// Waits for what the camera's own thread does, as long as it takes.
  void until(const std::function<bool()>& done) {
    for (int i = 0; i < 6000 && !done(); ++i) {
      next(rt::kNsPerMs);
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    ASSERT_TRUE(done());
  }

  FakeDevice device_;
  V4l2Settings settings_;
  Told told_;
  std::unique_ptr<V4l2Camera> camera_;
  std::vector<std::uint8_t> pixels_, bgr_;
  CapturedFrame frame_;
  std::string why_;
  rt::TimeNs stamp_ns_ = 100 * rt::kNsPerSecond - 5 * rt::kNsPerMs;
  std::uint32_t sequence_ = 0;
};

TEST_F(V4l2CameraTest, DeliversPicturesWithoutAllocationOrLock) {
  open();
  EXPECT_TRUE(camera_->real_time());
  EXPECT_EQ(camera_->channels(), 1);
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  const rt::HeapCounts before = rt::rt_heap_counts();
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
  const std::uint64_t locks = rt::rt_lock_count();
#endif
  for (int i = 0; i < 50; ++i) {
    const rt::RtScope real_time;
    ASSERT_EQ(shoot(static_cast<std::uint8_t>(i)), CameraStatus::kFrame);
    ASSERT_EQ(pixels_.front(), i);
    ASSERT_EQ(pixels_.back(), i);
    ASSERT_EQ(frame_.t_capture_ns, stamp_ns_);
    ASSERT_EQ(frame_.sequence, static_cast<std::uint32_t>(i + 1));
  }
  EXPECT_EQ(rt::rt_heap_counts().allocations, before.allocations);
  EXPECT_EQ(rt::rt_heap_counts().frees, before.frees);
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
  EXPECT_EQ(rt::rt_lock_count(), locks);
#endif
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

TEST_F(V4l2CameraTest, ADeviceThatGoesComesBack) {
  open();
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  device_.there = false;
  EXPECT_EQ(next(), CameraStatus::kTimeout);
  EXPECT_FALSE(camera_->streaming());
  until([&] { return told_.has("cannot be opened"); });
  device_.there = true;
  until([&] { return camera_->streaming(); });
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

TEST_F(V4l2CameraTest, ControlsAreSetByNameAtEachStart) {
  device_.controls[V4L2_CID_EXPOSURE_AUTO] = {"Exposure, Auto", 3};
  device_.controls[V4L2_CID_GAIN] = {"Gain", 0};
  settings_.controls = {{"exposure_auto", 1}, {"0x00980913", 44}};
  open();
  EXPECT_EQ(device_.controls[V4L2_CID_EXPOSURE_AUTO].second, 1);
  EXPECT_EQ(device_.controls[V4L2_CID_GAIN].second, 44);
}

// As JetPack's sensor drivers have exposure and gain.
TEST_F(V4l2CameraTest, ControlsOf64BitsAreSetWholeAndOthersNotCutOff) {
  constexpr std::int64_t kNs = 33'333'333'333;
  device_.controls64[0x009a200a] = {"Exposure", 0};
  settings_.controls = {{"exposure", kNs}};
  open();
  EXPECT_EQ(device_.controls64[0x009a200a].second, kNs);
  device_.controls[V4L2_CID_GAIN] = {"Gain", 0};
  settings_.controls = {{"gain", kNs}};
  open();
  EXPECT_TRUE(told_.has("control gain = 33333333333: Numerical result out of range")) << told_.all;
}

TEST_F(V4l2CameraTest, MjpegIsDecodedAndWhatIsCutOffIsBad) {
  const cv::Mat picture(48, 64, CV_8UC3, cv::Scalar(30, 120, 200));
  cv::imencode(".jpg", picture, device_.jpeg);
  device_.formats = {V4L2_PIX_FMT_MJPEG};
  open();
  EXPECT_FALSE(camera_->real_time());
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  EXPECT_NEAR(pixels_[100], 0.114 * 30 + 0.587 * 120 + 0.299 * 200, 3);
  EXPECT_NEAR(bgr_[300], 30, 4);
  EXPECT_NEAR(bgr_[302], 200, 4);
  const auto half = static_cast<std::int64_t>(device_.jpeg.size() / 2);
  EXPECT_EQ(shoot(7, 0, half), CameraStatus::kBadFrame);
  EXPECT_NE(why_.find("JPEG"), std::string::npos);
  EXPECT_EQ(shoot(7, 0, 0), CameraStatus::kBadFrame);
  cv::imencode(".jpg", cv::Mat(48, 32, CV_8UC3, cv::Scalar::all(9)), device_.jpeg);
  EXPECT_EQ(shoot(), CameraStatus::kBadFrame);
  EXPECT_NE(why_.find("another size"), std::string::npos);
  cv::imencode(".jpg", picture, device_.jpeg);
  EXPECT_EQ(shoot(), CameraStatus::kFrame);
}

TEST(VideoNode, DevicesAreChosenByPathNameOrSerialNumber) {
  const std::vector<VideoNode> nodes{{"/dev/video0", {"usb-Cam_A-video-index0"}, "A1"},
                                     {"/dev/video2", {"usb-Cam_B-video-index0"}, "B2"}};
  EXPECT_EQ(choose_video_node("/dev/video7", nodes).path, "/dev/video7");
  EXPECT_EQ(choose_video_node("serial:B2", nodes).path, "/dev/video2");
  EXPECT_EQ(choose_video_node("by-id:Cam_A", nodes).path, "/dev/video0");
  EXPECT_NE(choose_video_node("by-id:Cam", nodes).error.find("fits 2"), std::string::npos);
  EXPECT_NE(choose_video_node("serial:C", nodes).error.find("there are /dev/video0"), std::string::npos);
}

}  // namespace
}  // namespace godwit::hal
