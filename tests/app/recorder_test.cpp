#include "firmware_app/output/recorder.h"

#include <algorithm>
#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <gtest/gtest.h>
#include <string>
#include <unistd.h>

#include "hal/camera/replay/replay_camera.h"
#include "hal/imu/replay/imu_record.h"
#include "hal/rt/process_end.h"
#include "hal/rt/time.h"
#include "hal/rt/wake_up.h"
#include "tests/support/temp_folder.h"

namespace godwit::app {
namespace recorder_test {

constexpr const char* kCalibration =
    "model: pinhole\nwidth: 96\nheight: 64\nfx: 90\nfy: 90\ncx: 48\ncy: 32\ndistortion_model: none\ndistortion: []\n";

/// Fewer pictures than there are slots: however slow the disc is, none can be dropped.
class Pictures final : public hal::Camera {
 public:
  explicit Pictures(int count) : count_(count) {}
  int width() const override { return 96; }
  int height() const override { return 64; }
  int channels() const override { return 1; }
  hal::CameraStatus next(const rt::MutableImageView& grey, std::uint8_t* /*bgr*/, rt::TimeNs /*timeout_ns*/,
                         hal::CapturedFrame* frame, std::string* why) override {
    if (number_ == count_) return hal::CameraStatus::kEnd;
    frame->sequence = static_cast<std::uint32_t>(number_ < 10 ? number_ : number_ + 2);  // two are missing
    frame->t_capture_ns = 1'000'000'000'000 + number_ * 16'666'667LL;
    ++number_;
    if (before_picture) before_picture(number_, frame->t_capture_ns);
    if (number_ == 5) {
      *why = "bad";
      return hal::CameraStatus::kBadFrame;
    }
    if (grey.data == nullptr) return hal::CameraStatus::kFrame;
    for (int y = 0; y < 64; ++y) std::fill_n(grey.row(y), 96, static_cast<std::uint8_t>(number_));
    return hal::CameraStatus::kFrame;
  }
  std::function<void(int number, rt::TimeNs t_capture_ns)> before_picture;

 private:
  const int count_;
  int number_ = 0;
};

class Samples final : public hal::Imu {
 public:
  double rate_hz() const override { return 200; }
  hal::ImuStatus next(hal::ImuSample* s, rt::TimeNs /*timeout_ns*/) override {
    if (number_ == 100) return hal::ImuStatus::kEnd;
    *s = {};
    s->t_ns = 1'000'000'000'000 + number_ * 5'000'000LL;
    s->gyro_rad_s = {0.001 * number_, 0, -0.5};
    s->accel_m_s2 = {0, 0, -9.81};
    ++number_;
    return hal::ImuStatus::kSample;
  }
  bool done() const { return number_ == 100; }
  hal::ImuRanges ranges() const override { return ranges_; }
  hal::ImuRanges ranges_;

 private:
  std::atomic<int> number_{0};
};

TEST(Recorder, WhatIsRecordedCanBeReplayed) {
  const test::TempFolder folder;
  Pictures camera(40);
  RecorderOptions options;
  options.out = folder / "flight";
  options.calibration = kCalibration;
  const std::atomic<bool> stop{false};
  const auto done = record_devices(&camera, nullptr, options, {}, stop);
  ASSERT_TRUE(done.ok()) << done.error().message;
  EXPECT_EQ(done.value().pictures, 39u);
  EXPECT_EQ(done.value().bad, 1u);
  EXPECT_EQ(done.value().missed, 2u);
  EXPECT_EQ(done.value().dropped, 0u);
  auto replay = hal::ReplayCamera::open(options.out, {});
  ASSERT_TRUE(replay.ok()) << replay.error().message;
  EXPECT_EQ(replay.value()->total(), 39);
  std::vector<std::uint8_t> pixels(96 * 64);
  hal::CapturedFrame frame;
  ASSERT_EQ(replay.value()->next({pixels.data(), 96, 64, 96}, nullptr, 0, &frame, nullptr), hal::CameraStatus::kFrame);
  EXPECT_EQ(pixels[0], 1);
  EXPECT_EQ(frame.t_source_ns, 1'000'000'000'000);
  EXPECT_FALSE(record_devices(&camera, nullptr, options, {}, stop).ok()) << "nothing is recorded over";
}

/// All that the sensor gives, alone.
void record_alone(Samples* imu, const std::string& out) {
  RecorderOptions options;
  options.out = out;
  std::atomic<bool> stop{false};
  const auto done = record_devices(
      nullptr, imu, options, [&](const Recorded& r, std::uint64_t) { stop = r.samples == 100; }, stop);
  ASSERT_TRUE(done.ok()) << done.error().message;
  EXPECT_EQ(done.value().samples, 100u);
}

TEST(Recorder, TheInertialSensorAloneIsRecordedToo) {
  const test::TempFolder folder;
  Samples imu;
  record_alone(&imu, folder / "still");
  const auto record = hal::read_imu_record(folder / "still");
  ASSERT_TRUE(record.ok()) << record.error().message;
  EXPECT_EQ(record.value().samples.size(), 100u);
  EXPECT_NEAR(record.value().samples[7].gyro_rad_s[0], 0.007, 1e-9);
}

// A reading at the end of its axis is a lower bound: without the ranges a replay took it for one.
TEST(Recorder, TheEndsOfTheSensorsAxesAreRecorded) {
  for (const hal::ImuRanges ranges : {hal::ImuRanges{0.5, 78.4532}, hal::ImuRanges{}, hal::ImuRanges{1e6, 1e6}}) {
    const test::TempFolder folder;
    Samples imu;
    imu.ranges_ = ranges;
    record_alone(&imu, folder / "ends");
    const bool known = ranges.gyro_rad_s == 0.5;
    EXPECT_EQ(std::filesystem::exists(folder / "ends/mav0/imu0/sensor.yaml"), known);
    const auto record = hal::read_imu_record(folder / "ends");
    ASSERT_TRUE(record.ok()) << record.error().message;
    EXPECT_EQ(record.value().saturated, known ? 100u : 0u) << "-0.5 rad/s about z";
    EXPECT_NEAR(record.value().errors.accelerometer_range.value_or(0), known ? 78.4532 : 0, 1e-6);
  }
}

TEST(Recorder, ADiscThatIsNearlyFullEndsItInGoodTime) {
  const test::TempFolder folder;
  Samples imu;
  RecorderOptions options;
  options.out = folder / "full";
  options.free_bytes = ~0ULL;
  const std::atomic<bool> stop{false};
  const auto done = record_devices(nullptr, &imu, options, {}, stop);
  ASSERT_TRUE(done.ok()) << done.error().message;
  EXPECT_TRUE(done.value().disc_full);
  EXPECT_TRUE(std::filesystem::exists(options.out + "/mav0/imu0/data.csv")) << "what there was before is whole";
}

/// Its driver does not come back once 20 pictures are there.
class HangingPictures final : public hal::Camera {
 public:
  int width() const override { return pictures_.width(); }
  int height() const override { return pictures_.height(); }
  int channels() const override { return 1; }
  hal::CameraStatus next(const rt::MutableImageView& grey, std::uint8_t* bgr, rt::TimeNs timeout_ns,
                         hal::CapturedFrame* frame, std::string* why) override {
    const hal::CameraStatus status = pictures_.next(grey, bgr, timeout_ns, frame, why);
    while (status == hal::CameraStatus::kEnd) {
      hangs = true;
      rt::sleep_until_ns(rt::monotonic_now_ns() + rt::kNsPerSecond);
    }
    return status;
  }
  std::atomic<bool> hangs{false};

 private:
  Pictures pictures_{20};
};

TEST(RecorderDeathTest, ACameraThatHangsIsNamedAndWhatItGaveIsWhole) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  // Both processes of this test must know the folder.
  const std::string out = std::filesystem::temp_directory_path() / "godwit_recorder_hangs";
  const auto record = [&] {
    std::filesystem::remove_all(out);
    rt::abandon_threads_by([](const char* thread) {
      std::fprintf(stderr, "%s hangs\n", thread);
      std::_Exit(3);
    });
    HangingPictures camera;
    RecorderOptions options;
    options.out = out;
    options.calibration = kCalibration;
    std::atomic<bool> stop{false};
    const auto done = record_devices(
        &camera, nullptr, options, [&](const Recorded&, std::uint64_t) { stop = camera.hangs.load(); }, stop);
    std::_Exit(done.ok() ? 0 : 1);
  };
  alarm(120);
  EXPECT_EXIT(record(), ::testing::ExitedWithCode(3), "gw-camera hangs");
  alarm(0);
  const auto replay = hal::ReplayCamera::open(out, {});
  ASSERT_TRUE(replay.ok()) << replay.error().message;
  EXPECT_EQ(replay.value()->total(), 19);
  std::filesystem::remove_all(out);
}

TEST(Recorder, APictureThatCannotBeWrittenIsToldAndThoseBeforeAreToBeFound) {
  const test::TempFolder folder;
  Pictures camera(40);
  RecorderOptions options;
  options.out = folder / "flight";
  options.calibration = kCalibration;
  // The name of the 30th picture is taken, by something that no picture can be written over.
  std::filesystem::create_directories(options.out);
  const std::atomic<bool> stop{false};
  camera.before_picture = [&](int number, rt::TimeNs t_capture_ns) {
    if (number != 30) return;
    std::filesystem::create_directories(options.out + "/mav0/cam0/data/" + std::to_string(t_capture_ns) + ".png/taken");
  };
  const auto done = record_devices(&camera, nullptr, options, {}, stop);
  ASSERT_FALSE(done.ok());
  EXPECT_NE(done.error().message.find("cannot be written"), std::string::npos) << done.error().message;
  auto replay = hal::ReplayCamera::open(options.out, {});
  ASSERT_TRUE(replay.ok()) << replay.error().message;
  EXPECT_GE(replay.value()->total(), 20);
}

TEST(Recorder, AFolderThatCannotBeMadeIsAnError) {
  Samples imu;
  RecorderOptions options;
  options.out = "/proc/no";
  const std::atomic<bool> stop{false};
  EXPECT_FALSE(record_devices(nullptr, &imu, options, {}, stop).ok());
}

}  // namespace recorder_test
}  // namespace godwit::app
