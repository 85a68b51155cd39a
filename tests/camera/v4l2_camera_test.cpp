#include "hal/camera/v4l2/v4l2_camera.h"

#include <filesystem>
#include <gtest/gtest.h>
#include <mutex>
#include <opencv2/imgcodecs.hpp>
#include <thread>

#include "hal/camera/fed_camera.h"
#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"
#include "tests/camera/fake_video.h"
#include "tests/camera/no_cost.h"
#include "tests/support/temp_folder.h"

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

TEST_F(V4l2CameraTest, AFixedExposureAndGainAreSetAndTheDevicesOwnSwitchedOff) {
  device_.controls[V4L2_CID_EXPOSURE_AUTO] = {"Exposure, Auto", 3};
  device_.controls[V4L2_CID_AUTOGAIN] = {"Gain, Automatic", 1};
  device_.controls[V4L2_CID_EXPOSURE_ABSOLUTE] = {"Exposure Time, Absolute", 300};
  device_.controls[V4L2_CID_GAIN] = {"Gain", 16};
  settings_.exposure.mode = ExposureMode::kFixed;
  settings_.exposure.fixed = {2'570'000, 3};
  settings_.exposure.gain_one = 16;
  open();
  EXPECT_EQ(device_.controls[V4L2_CID_EXPOSURE_AUTO].second, V4L2_EXPOSURE_MANUAL);
  EXPECT_EQ(device_.controls[V4L2_CID_AUTOGAIN].second, 0);
  EXPECT_EQ(device_.controls[V4L2_CID_EXPOSURE_ABSOLUTE].second, 25) << "in steps of 100 us";
  EXPECT_EQ(device_.controls[V4L2_CID_GAIN].second, 49) << "gain makes up for the 70 us that are missing";
  stamp_ns_ -= 1000;
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  EXPECT_EQ(frame_.t_capture_ns, stamp_ns_ - 1'250'000);
}

TEST_F(V4l2CameraTest, ExposureOfTegraIsInMicrosecondsAndThatOfASensorInLines) {
  device_.controls64[0x009a200a] = {"Exposure", 0};
  device_.controls64[0x009a2009] = {"Gain", 0};
  settings_.exposure.mode = ExposureMode::kFixed;
  settings_.exposure.fixed = {2'570'000, 4};
  open();
  EXPECT_EQ(device_.controls64[0x009a200a].second, 2570);
  EXPECT_EQ(device_.controls64[0x009a2009].second, 40) << "its lowest, 10, is gain 1";
  camera_.reset();
  device_.controls64.clear();
  device_.controls[V4L2_CID_EXPOSURE] = {"Exposure", 100};
  open();
  EXPECT_TRUE(told_.has("camera.exposure_unit_us is needed")) << told_.all;
  EXPECT_EQ(device_.controls[V4L2_CID_EXPOSURE].second, 100);
  camera_.reset();
  // 64 columns and 136 of blanking at 10 MHz: a line lasts 20 us.
  device_.controls[V4L2_CID_HBLANK] = {"Horizontal Blanking", 136};
  device_.controls64[V4L2_CID_PIXEL_RATE] = {"Pixel Rate", 10'000'000};
  open();
  EXPECT_EQ(device_.controls[V4L2_CID_EXPOSURE].second, 128);
}

TEST_F(V4l2CameraTest, GainInDecibelsIsReckonedAndNamedControlsAreUsed) {
  device_.controls[V4L2_CID_GAIN] = {"Gain", 1};
  device_.controls[V4L2_CID_BRIGHTNESS] = {"Brightness", 1};
  settings_.exposure.mode = ExposureMode::kFixed;
  settings_.exposure.fixed = {1'000'000, 10};
  settings_.exposure.gain_step_db = 0.1;
  settings_.exposure.exposure_control = "brightness";
  settings_.exposure.exposure_unit_ns = 10'000;
  open();
  EXPECT_EQ(device_.controls[V4L2_CID_GAIN].second, 200);
  EXPECT_EQ(device_.controls[V4L2_CID_BRIGHTNESS].second, 100);
  settings_.exposure.exposure_control = "shutter";
  open();
  EXPECT_TRUE(told_.has("has no control shutter; it has brightness, gain")) << told_.all;
}

/// A sensor of which each setting is in a picture `delay` pictures later.
class AutomaticExposureTest : public V4l2CameraTest {
 protected:
  void open_automatic() {
    device_.controls[V4L2_CID_EXPOSURE_ABSOLUTE] = {"Exposure Time, Absolute", 40};
    device_.controls[V4L2_CID_GAIN] = {"Gain", 1};
    settings_.exposure.mode = ExposureMode::kAutomatic;
    settings_.exposure.automatic.focal_px = 500;
    open();
  }
  /// Waits until the camera's own thread has looked at the picture. Its mean.
  int picture(double scene, std::size_t delay) {
    set_.push_back(device_.control(V4L2_CID_EXPOSURE_ABSOLUTE) * device_.control(V4L2_CID_GAIN));
    const int light = set_[set_.size() > delay ? set_.size() - 1 - delay : 0];
    const int value = static_cast<int>(std::min(255.0, scene * light));
    EXPECT_EQ(shoot(static_cast<std::uint8_t>(value)), CameraStatus::kFrame);
    ++looked_at_;
    for (int i = 0; i < 60'000 && camera_->steered() < looked_at_; ++i) {
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    EXPECT_EQ(camera_->steered(), looked_at_);
    return value;
  }
  std::vector<int> set_;
  std::uint64_t looked_at_ = 0;
};

TEST_F(AutomaticExposureTest, SettlesWithinTenPicturesAfterAFactorOfEight) {
  open_automatic();
  for (const std::size_t delay : {std::size_t{0}, std::size_t{3}}) {
    for (const double scene : {2.5, 20.0, 2.5, 0.3}) {
      int value = 0;
      for (int i = 0; i < 11; ++i) value = picture(scene, delay);
      EXPECT_NEAR(value, 100, 15) << "scene " << scene << " delay " << delay;
      for (int i = 0; i < 15; ++i) EXPECT_NEAR(picture(scene, delay), 100, 15) << "it swings";
    }
  }
}

// Whoever reads late finds pictures in the driver's buffers that were taken before the last setting.
TEST_F(AutomaticExposureTest, ALateReaderMakesItNotSwing) {
  open_automatic();
  constexpr int kBehind = 5;
  const auto take = [&] {
    device_.now_ns += kFrameNs;
    stamp_ns_ += kFrameNs;
    const int light = device_.control(V4L2_CID_EXPOSURE_ABSOLUTE) * device_.control(V4L2_CID_GAIN);
    EXPECT_TRUE(device_.shoot(static_cast<std::uint8_t>(std::min(255.0, 5.0 * light)), stamp_ns_, sequence_++));
  };
  for (int i = 0; i < kBehind; ++i) take();
  int swings = 0;
  for (int i = 0; i < 80; ++i) {
    take();
    ASSERT_EQ(next(), CameraStatus::kFrame);
    ++looked_at_;
    for (int n = 0; n < 60'000 && camera_->steered() < looked_at_; ++n) {
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    if (i >= 30 && std::abs(pixels_.front() - 100) > 15) ++swings;
  }
  EXPECT_EQ(swings, 0);
}

TEST_F(AutomaticExposureTest, ATurnShortensTheExposureAndGainMakesUpForIt) {
  open_automatic();
  for (int i = 0; i < 10; ++i) picture(2.5, 0);
  EXPECT_EQ(device_.control(V4L2_CID_EXPOSURE_ABSOLUTE), 40);
  for (int i = 0; i < 10; ++i) {
    camera_->turning(-1.0);  // 500 pixels a second: 2 ms for one
    camera_->turning(0.5);   // the largest since the last picture counts
    picture(2.5, 0);
  }
  EXPECT_EQ(device_.control(V4L2_CID_EXPOSURE_ABSOLUTE), 20);
  EXPECT_EQ(device_.control(V4L2_CID_GAIN), 2);
  // The stamps' middle follows what was set.
  ASSERT_EQ(shoot(100), CameraStatus::kFrame);
  EXPECT_EQ(frame_.t_capture_ns, stamp_ns_ - rt::kNsPerMs);
}

TEST_F(AutomaticExposureTest, ADriverThatIsSlowToSetHoldsUpNoPicture) {
  open_automatic();
  picture(2.5, 0);
  device_.holds_settings = true;
  ASSERT_EQ(shoot(20), CameraStatus::kFrame);
  for (int i = 0; i < 60'000 && device_.held == 0; ++i) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  ASSERT_GE(device_.held, 1);
  const rt::HeapCounts before = rt::rt_heap_counts();
  for (int i = 0; i < 40; ++i) {
    const rt::RtScope real_time;
    ASSERT_EQ(shoot(20), CameraStatus::kFrame);
  }
  EXPECT_EQ(rt::rt_heap_counts().allocations, before.allocations);
  device_.holds_settings = false;
}

TEST_F(AutomaticExposureTest, ADeviceThatComesBackGoesOnWithTheExposureItHad) {
  open_automatic();
  for (int i = 0; i < 12; ++i) picture(20, 0);
  const int exposure = device_.control(V4L2_CID_EXPOSURE_ABSOLUTE);
  EXPECT_NEAR(exposure, 5, 1);
  device_.there = false;
  EXPECT_EQ(next(), CameraStatus::kTimeout);
  device_.controls[V4L2_CID_EXPOSURE_ABSOLUTE].second = 300;  // as it wakes up
  device_.there = true;
  until([&] { return camera_->streaming(); });
  EXPECT_EQ(device_.control(V4L2_CID_EXPOSURE_ABSOLUTE), exposure);
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

TEST_F(V4l2CameraTest, FedByAThreadOfItsOwnMjpegCostsTheReaderNoHeapAndNoLock) {
  const cv::Mat picture(48, 64, CV_8UC3, cv::Scalar(30, 120, 200));
  cv::imencode(".jpg", picture, device_.jpeg);
  device_.formats = {V4L2_PIX_FMT_MJPEG};
  device_.real_waits = true;
  open();
  V4l2Camera* const inner = camera_.get();
  auto fed = FedCamera::start(std::move(camera_), {});
  ASSERT_TRUE(fed.ok());
  FedCamera& camera = *fed.value();
  EXPECT_TRUE(camera.real_time());
  EXPECT_EQ(camera.channels(), 3);
  const auto shoot_and_read = [&] {
    device_.now_ns += kFrameNs;
    stamp_ns_ = device_.now_ns - rt::kNsPerMs;
    while (!device_.shoot(7, stamp_ns_, sequence_)) std::this_thread::yield();
    ++sequence_;
    CameraStatus status = CameraStatus::kTimeout;
    for (int i = 0; i < 600 && status == CameraStatus::kTimeout; ++i) {
      status = camera.next(grey(), bgr_.data(), 100 * rt::kNsPerMs, &frame_, &why_);
    }
    return status;
  };
  ASSERT_EQ(shoot_and_read(), CameraStatus::kFrame);
  test::expect_no_heap_and_no_lock(29, [&](int i) {
    ASSERT_EQ(shoot_and_read(), CameraStatus::kFrame);
    ASSERT_EQ(frame_.sequence, static_cast<std::uint32_t>(i + 1));
    ASSERT_EQ(frame_.t_source_ns, stamp_ns_ / 1000 * 1000);
    ASSERT_NEAR(pixels_.back(), 0.114 * 30 + 0.587 * 120 + 0.299 * 200, 3);
    ASSERT_NEAR(bgr_.back(), 200, 4);
  });
  device_.jpeg.resize(device_.jpeg.size() / 2);
  EXPECT_EQ(shoot_and_read(), CameraStatus::kBadFrame);
  EXPECT_NE(why_.find("JPEG"), std::string::npos);
  // Nobody takes them: they are passed over, and the newest four are kept waiting no longer than that.
  for (int i = 0; i < 60'000 && camera.passed_over() == 0; ++i) {
    device_.now_ns += kFrameNs;
    stamp_ns_ = device_.now_ns - rt::kNsPerMs;
    device_.shoot(7, stamp_ns_, sequence_++);
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  EXPECT_GT(camera.passed_over(), 0u);
  EXPECT_GE(inner->counters().damaged, 1u);
}

TEST(LinuxVideo, ANodeWithoutADeviceHasNoSerialNumber) {
  const test::TempFolder folder;
  std::filesystem::create_directories(folder / "sys/class/video4linux/video0");
  std::filesystem::create_directories(folder / "sys/class/video4linux/video3/device");
  test::write_file(folder / "sys/class/video4linux/video3/device/serial", "A3\n");
  test::write_file(folder / "serial", "of the working folder\n");
  const std::filesystem::path before = std::filesystem::current_path();
  std::filesystem::current_path(std::string(folder / "."));
  const auto nodes = linux_video_system(folder / "sys", folder / "dev")->nodes();
  std::filesystem::current_path(before);
  ASSERT_EQ(nodes.size(), 2u);
  EXPECT_EQ(nodes[0].serial, "");
  EXPECT_EQ(nodes[1].serial, "A3");
}

// A folder that is read in pieces and goes in between ends with an error, which an iterator's ++ throws.
TEST(LinuxVideo, DevicesThatGoWhileTheyAreListedAreNoExceptionOfOurs) {
  const test::TempFolder folder;
  const std::string nodes = folder / "sys/class/video4linux";
  for (int round = 0; round < 2; ++round) {
    std::filesystem::create_directories(nodes);
    for (int i = 0; i < 1300; ++i) test::write_file(nodes + "/video" + std::to_string(i), "");
    std::thread unplugs([&] { std::filesystem::remove_all(nodes); });
    const auto system = linux_video_system(folder / "sys", folder / "dev");
    EXPECT_NO_THROW(system->nodes());
    unplugs.join();
  }
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
