#include "hal/camera/v4l2/v4l2_exposure.h"

#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"
#include "tests/camera/v4l2_fixture.h"
#include "tests/support/abandoned.h"

namespace godwit::hal::v4l2_exposure_test {
namespace {

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

TEST_F(AutomaticExposureTest, ADriverThatHangsIsNamedAndKeepsNoEndAway) {
  open_automatic();
  picture(2.5, 0);
  device_.holds_settings = true;
  ASSERT_EQ(shoot(20), CameraStatus::kFrame);
  for (int i = 0; i < 60'000 && device_.held == 0; ++i) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  ASSERT_GE(device_.held, 1);
  EXPECT_EQ(test::abandoned_by([&] { camera_.reset(); }, [&] { device_.holds_settings = false; }), "gw-v4l2");
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

}  // namespace
}  // namespace godwit::hal::v4l2_exposure_test
