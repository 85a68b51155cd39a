#include "hal/camera/libcamera/libcamera_camera.h"

#include <filesystem>
#include <functional>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <mutex>

#include "tests/camera/fake_libcamera.h"
#include "tests/camera/no_cost.h"
#include "tests/support/abandoned.h"

namespace godwit::hal::libcamera_camera_test {
namespace {

using test::FakeLibcamera;
using ::testing::HasSubstr;
using State = CompletedRequest::State;

constexpr rt::TimeNs kFrameNs = 33 * rt::kNsPerMs;

class LibcameraCameraTest : public ::testing::Test {
 protected:
  void open() {
    settings_.device = settings_.device.empty() ? "index:0" : settings_.device;
    settings_.width = 64;
    settings_.height = 48;
    auto camera =
        LibcameraCamera::open(std::make_unique<test::FakeLibcameraSystem>(&device_),
                              std::make_unique<test::FakeClocks>(&device_), settings_, [this](const std::string& text) {
                                const std::lock_guard<std::mutex> lock(mutex_);
                                told_ += text + "\n";
                              });
    ASSERT_TRUE(camera.ok());
    camera_ = std::move(camera).value();
    pixels_.assign(64 * 48, 0);
    bgr_.assign(pixels_.size() * 3, 0);
    why_.reserve(256);
  }
  /// What it says when it is opened as the device is now, and that it holds nothing of it.
  std::string refusal() {
    camera_.reset();
    told_.clear();
    open();
    EXPECT_EQ(next(), CameraStatus::kTimeout);
    camera_.reset();
    EXPECT_EQ(device_.sessions, 0);
    return told_;
  }
  std::string told() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return told_;
  }
  CameraStatus next(rt::TimeNs timeout_ns = rt::kNsPerMs) {
    return camera_->next({pixels_.data(), 64, 48, 64}, bgr_.data(), timeout_ns, &frame_, &why_);
  }
  /// One picture taken and read a little later.
  CameraStatus shoot(std::uint8_t value = 7, State state = State::kGood, std::size_t bytes = 0,
                     rt::TimeNs exposure_ns = 0) {
    device_.now_ns += kFrameNs;
    stamp_ns_ += kFrameNs;
    EXPECT_TRUE(device_.shoot(value, {.state = state,
                                      .stamp_ns = stamp_ns_,
                                      .sensor_stamp = true,
                                      .sequence = sequence_++,
                                      .bytes = bytes,
                                      .exposure_ns = exposure_ns}));
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

  FakeLibcamera device_;
  DeviceSettings settings_;
  std::mutex mutex_;
  std::string told_;
  std::unique_ptr<LibcameraCamera> camera_;
  std::vector<std::uint8_t> pixels_, bgr_;
  CapturedFrame frame_;
  std::string why_;
  rt::TimeNs stamp_ns_ = 100 * rt::kNsPerSecond - 5 * rt::kNsPerMs;
  std::uint32_t sequence_ = 0;
};

TEST_F(LibcameraCameraTest, DeliversPicturesWithoutAllocationOrLock) {
  open();
  EXPECT_TRUE(camera_->real_time());
  EXPECT_EQ(camera_->channels(), 1);
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  // libcamera's thread is this one, too: what it does of ours is held to the same.
  test::expect_no_heap_and_no_lock(50, [this](int i) {
    ASSERT_EQ(shoot(static_cast<std::uint8_t>(i)), CameraStatus::kFrame);
    ASSERT_EQ(pixels_.front(), i);
    ASSERT_EQ(pixels_.back(), i);
    ASSERT_EQ(frame_.t_capture_ns, stamp_ns_);
    ASSERT_EQ(frame_.sequence, static_cast<std::uint32_t>(i + 1));
  });
}

TEST_F(LibcameraCameraTest, ColourIsGivenWhereTheCameraHasIt) {
  device_.formats = {PixelFormat::kRgb3};
  open();
  EXPECT_EQ(camera_->channels(), 3);
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  EXPECT_EQ(bgr_.back(), 7);
  EXPECT_EQ(pixels_.back(), 7);
}

TEST_F(LibcameraCameraTest, PlanAndFixedExposureReachTheCamera) {
  settings_.fps = 25;
  settings_.format = PixelFormat::kNv12;
  settings_.exposure.mode = ExposureMode::kFixed;
  settings_.exposure.fixed = {4 * rt::kNsPerMs, 2};
  device_.formats = {PixelFormat::kGrey, PixelFormat::kNv12};
  open();
  EXPECT_EQ(device_.plan.format, PixelFormat::kNv12);
  EXPECT_EQ(device_.plan.fps, 25);
  ASSERT_TRUE(device_.plan.fixed);
  EXPECT_EQ(device_.plan.fixed->exposure_ns, 4 * rt::kNsPerMs);
  EXPECT_EQ(device_.plan.fixed->gain, 2);
}

TEST_F(LibcameraCameraTest, WrongSizesFormatsAndRefusalsAreToldInWords) {
  device_.width = 60;
  EXPECT_THAT(refusal(), HasSubstr("libcamera, platform/fake.0 Sensor: gives pictures of 60x48, not the 64x48 of the"));
  device_.width = 0;
  device_.gives_format = "YU12";
  EXPECT_THAT(refusal(), HasSubstr("gives YU12 instead of GREY"));
  device_.gives_format.clear();
  device_.others = "YU12 AB24";
  device_.formats.clear();
  EXPECT_THAT(refusal(), HasSubstr("does not offer a format that is read here; it offers YU12 AB24"));
  device_.formats = {PixelFormat::kGrey};
  settings_.format = PixelFormat::kNv12;
  EXPECT_THAT(refusal(), HasSubstr("does not offer NV12; it offers YU12 AB24 GREY"));
  settings_.format.reset();
  device_.stride = 63;
  EXPECT_THAT(refusal(), HasSubstr("says its rows take 63 bytes; 64 at least are needed"));
  device_.stride = 0;
  device_.buffer_bytes = 100;
  EXPECT_THAT(refusal(), HasSubstr("its buffers hold 100 bytes; a picture has 3072"));
  device_.buffer_bytes = 0;
  device_.buffers = 1;
  EXPECT_THAT(refusal(), HasSubstr("gives 1 buffers; two are needed"));
  device_.buffers = 0;
  device_.acquire_error = "another program uses it";
  EXPECT_THAT(refusal(), HasSubstr("another program uses it"));
  device_.acquire_error.clear();
  device_.configure_error = "the format is refused";
  EXPECT_THAT(refusal(), HasSubstr("the format is refused"));
  device_.configure_error.clear();
  device_.start_error = "does not begin to stream: Broken pipe";
  EXPECT_THAT(refusal(), HasSubstr("does not begin to stream"));
  device_.start_error.clear();
  device_.takes_requests = false;
  EXPECT_THAT(refusal(), HasSubstr("it takes no requests"));
  device_.takes_requests = true;
  settings_.device = "none such";
  EXPECT_THAT(refusal(), HasSubstr("named none such; there are platform/fake.0 Sensor"));
}

TEST_F(LibcameraCameraTest, RowsWithPaddingAreReadWithoutIt) {
  device_.stride = 128;
  open();
  ASSERT_EQ(shoot(9), CameraStatus::kFrame);
  EXPECT_EQ(pixels_.back(), 9);
}

TEST_F(LibcameraCameraTest, ShortAndMarkedBuffersAreBadPicturesAndTheNextOneIsGood) {
  open();
  EXPECT_EQ(shoot(7, State::kGood, 100), CameraStatus::kBadFrame);
  EXPECT_THAT(why_, HasSubstr("cut off"));
  EXPECT_EQ(shoot(7, State::kGood, 5000), CameraStatus::kBadFrame);
  EXPECT_THAT(why_, HasSubstr("more than the buffer holds"));
  EXPECT_EQ(shoot(7, State::kDamaged), CameraStatus::kBadFrame);
  EXPECT_THAT(why_, HasSubstr("damaged"));
  EXPECT_EQ(shoot(8), CameraStatus::kFrame);
  EXPECT_EQ(pixels_.front(), 8);
  EXPECT_EQ(camera_->counters().damaged, 3u);
}

TEST_F(LibcameraCameraTest, AGapInTheSequenceIsCounted) {
  open();
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  sequence_ += 3;
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  EXPECT_EQ(camera_->counters().lost, 3u);
  EXPECT_EQ(frame_.sequence, 4u);
}

TEST_F(LibcameraCameraTest, ACancelledRequestIsABadPictureAndItsBufferIsUsedAgain) {
  open();
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  // More than there are buffers: each came back. Its number says nothing.
  for (int i = 0; i < 20; ++i) {
    const std::uint32_t sequence = sequence_;
    sequence_ = 0;
    ASSERT_EQ(shoot(7, State::kCancelled), CameraStatus::kBadFrame);
    sequence_ = sequence + 1;
    ASSERT_EQ(shoot(), CameraStatus::kFrame);
  }
  EXPECT_EQ(camera_->counters().lost, 0u);
  EXPECT_EQ(camera_->counters().gone, 0u);
}

TEST_F(LibcameraCameraTest, ACameraThatCancelsAllIsOpenedAnew) {
  open();
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  for (int i = 0; i < 5; ++i) ASSERT_EQ(shoot(7, State::kCancelled), CameraStatus::kBadFrame);
  EXPECT_EQ(shoot(7, State::kCancelled), CameraStatus::kTimeout);
  EXPECT_EQ(camera_->counters().gone, 1u);
  until([&] { return camera_->streaming(); });
  EXPECT_EQ(device_.opened, 2);
  EXPECT_EQ(shoot(5), CameraStatus::kFrame);
}

TEST_F(LibcameraCameraTest, ARequestThatWasNotOutIsNotRead) {
  open();
  const int index = device_.take_queued();
  CompletedRequest request{.index = static_cast<std::uint32_t>(index), .stamp_ns = stamp_ns_, .bytes = 3072};
  device_.listener->completed(request);
  device_.listener->completed(request);
  request.index = 6;
  device_.listener->completed(request);
  request.index = 0xFFFFFFFF;
  device_.listener->completed(request);
  EXPECT_EQ(next(), CameraStatus::kFrame);
  EXPECT_EQ(next(), CameraStatus::kTimeout);
  EXPECT_EQ(shoot(), CameraStatus::kFrame);
}

TEST_F(LibcameraCameraTest, ATimeThatStandsStillIsBadAtFirstAndThenArrivalsAreUsed) {
  open();
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  stamp_ns_ -= kFrameNs;
  EXPECT_EQ(shoot(), CameraStatus::kBadFrame);
  EXPECT_THAT(why_, HasSubstr("stands still"));
  CameraStatus status = CameraStatus::kBadFrame;
  for (int i = 0; i < 3; ++i) {
    stamp_ns_ -= kFrameNs;
    status = shoot();
  }
  EXPECT_EQ(status, CameraStatus::kFrame);
  EXPECT_EQ(frame_.t_capture_ns, device_.now_ns);
}

TEST_F(LibcameraCameraTest, StampsOfBoottimeAreConverted) {
  constexpr rt::TimeNs kSlept = 3600 * rt::kNsPerSecond;
  device_.offsets.boottime_ns = -kSlept;
  stamp_ns_ += kSlept;
  open();
  for (int i = 0; i < 5; ++i) {
    ASSERT_EQ(shoot(), CameraStatus::kFrame);
    EXPECT_EQ(frame_.t_capture_ns, stamp_ns_ - kSlept);
  }
  EXPECT_EQ(camera_->clock().source(), DeviceClock::Source::kBoottime);
}

TEST_F(LibcameraCameraTest, ThePicturesOwnExposureGivesItsMiddle) {
  settings_.exposure_ns = 8 * rt::kNsPerMs;
  settings_.readout_ns = 2 * rt::kNsPerMs;
  settings_.rolling = true;
  stamp_ns_ -= 20 * rt::kNsPerMs;
  open();
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  EXPECT_EQ(frame_.t_capture_ns, stamp_ns_ + 5 * rt::kNsPerMs);
  ASSERT_EQ(shoot(7, State::kGood, 0, 2 * rt::kNsPerMs), CameraStatus::kFrame);
  EXPECT_EQ(frame_.t_capture_ns, stamp_ns_ + 2 * rt::kNsPerMs);
}

TEST_F(LibcameraCameraTest, ACameraThatGoesComesBack) {
  open();
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  device_.there = false;
  device_.listener->disconnected();
  EXPECT_EQ(next(), CameraStatus::kTimeout);
  EXPECT_FALSE(camera_->streaming());
  EXPECT_EQ(camera_->counters().gone, 1u);
  until([&] { return told().find("libcamera finds no camera") != std::string::npos; });
  EXPECT_EQ(device_.sessions, 0) << "it was let go";
  device_.there = true;
  until([&] { return camera_->streaming(); });
  EXPECT_EQ(camera_->counters().back, 1u);
  EXPECT_EQ(shoot(3), CameraStatus::kFrame);
  EXPECT_EQ(pixels_.front(), 3);
}

TEST_F(LibcameraCameraTest, OneThatTakesNoRequestBackOrFallsSilentIsOpenedAnew) {
  settings_.stall_ns = 500 * rt::kNsPerMs;
  open();
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  device_.takes_requests = false;
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  until([&] { return camera_->counters().gone == 1; });
  device_.takes_requests = true;
  until([&] { return camera_->streaming(); });
  ASSERT_EQ(camera_->counters().back, 1u);
  device_.now_ns += rt::kNsPerSecond;
  EXPECT_EQ(next(), CameraStatus::kTimeout);
  EXPECT_EQ(camera_->counters().stalls, 1u);
  until([&] { return camera_->streaming(); });
  EXPECT_EQ(camera_->counters().back, 2u);
}

TEST(LibcameraChoice, ByNumberIdOrAPartOfIt) {
  const std::vector<std::string> cameras{"/base/soc/i2c0mux/imx219@10", "/base/soc/i2c0mux/imx296@1a"};
  EXPECT_EQ(choose_libcamera("index:1", cameras).id, cameras[1]);
  EXPECT_EQ(choose_libcamera("imx219", cameras).id, cameras[0]);
  EXPECT_EQ(choose_libcamera(cameras[1], cameras).id, cameras[1]);
  EXPECT_THAT(choose_libcamera("index:2", cameras).error, HasSubstr("no camera of number 2; there are /base"));
  EXPECT_THAT(choose_libcamera("index:1x", cameras).error, HasSubstr("a number must follow"));
  EXPECT_THAT(choose_libcamera("index:", cameras).error, HasSubstr("a number must follow"));
  EXPECT_THAT(choose_libcamera("imx", cameras).error, HasSubstr("fits 2 cameras"));
  EXPECT_THAT(choose_libcamera("ov", {}).error, HasSubstr("libcamera finds no camera"));
}

TEST_F(LibcameraCameraTest, AThreadThatHangsIsNamedAndKeepsNoEndAway) {
  open();
  EXPECT_EQ(test::abandoned_while_stands("gw-libcamera", [&] { camera_.reset(); }), "gw-libcamera");
}

// As it was built: with libcamera its library loads and finds what there is, once at a time; without it the words say
// so.
TEST(LibcameraLibrary, LoadsOrSaysHowItWasBuilt) {
  auto first = load_libcamera();
  if (!std::filesystem::exists(libcamera_library())) {
    ASSERT_FALSE(first.ok());
    EXPECT_THAT(first.error().message, HasSubstr("this godwit was built without libcamera"));
    return;
  }
  ASSERT_TRUE(first.ok()) << first.error().message;
  const auto second = load_libcamera();
  ASSERT_FALSE(second.ok());
  EXPECT_THAT(second.error().message, HasSubstr("this program uses it already"));
  EXPECT_FALSE(first.value()->acquire("no such camera").ok());
  first = rt::Error{"given back"};
  EXPECT_TRUE(load_libcamera().ok());
}

}  // namespace
}  // namespace godwit::hal::libcamera_camera_test
