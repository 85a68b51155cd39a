#include "firmware_app/sim/flight_writer.h"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <string>

#include "hal/camera/replay/replay_camera.h"
#include "hal/imu/replay/imu_record.h"
#include "tests/sim/file_content.h"
#include "tests/sim/test_scenario.h"
#include "tests/support/temp_folder.h"

namespace godwit::app {
namespace {
namespace fs = std::filesystem;
using test::content;

int lines(const fs::path& file) {
  const std::string text = content(file);
  return static_cast<int>(std::count(text.begin(), text.end(), '\n'));
}

class FlightFolder : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    sim::Scenario scenario = sim::test::scenario("vibration");
    scenario.world.ground_texels = 1024;
    flight = new sim::Flight(scenario, 2);
  }
  static void TearDownTestSuite() {
    delete flight;
    flight = nullptr;
  }
  void SetUp() override { folder_ = temp_.path() / "flight"; }
  void TearDown() override { fs::remove_all(folder_); }

  static sim::Flight* flight;
  test::TempFolder temp_;  // of its own: tests run side by side
  fs::path folder_;
  std::atomic<bool> stop_{false};
};
sim::Flight* FlightFolder::flight = nullptr;

TEST_F(FlightFolder, IsReadByOurOwnReplay) {
  const auto written = write_flight(*flight, {folder_.string(), true, 150, 4}, stop_);
  ASSERT_TRUE(written.ok()) << written.error().message;
  EXPECT_EQ(written.value().pictures, 4);
  EXPECT_EQ(lines(folder_ / "rgb.txt"), 5);
  EXPECT_EQ(lines(folder_ / "mav0/cam0/data.csv"), 5);
  EXPECT_GT(lines(folder_ / "boxes.csv"), 4);
  EXPECT_EQ(lines(folder_ / "imu.txt"), 60 * 1000 + 2);
  EXPECT_EQ(lines(folder_ / "groundtruth.txt"), 60 * 200 + 2);
  for (const char* layout : {"", "mav0"}) {
    const auto errors = hal::read_imu_record_errors((folder_ / layout).string());
    ASSERT_TRUE(errors.ok()) << errors.error().message;
    EXPECT_EQ(errors.value().accelerometer_noise_density, flight->scenario().imu.accel_noise) << layout;
    EXPECT_EQ(errors.value().accelerometer_bias_sigma, flight->scenario().imu.accel_bias) << layout;
  }
  for (const char* layout : {"", "mav0"}) {
    auto camera = hal::ReplayCamera::open((folder_ / layout).string(), {});
    ASSERT_TRUE(camera.ok()) << camera.error().message;
    const hal::CameraCalibration& c = camera.value()->calibration();
    const int width = flight->scenario().camera.rig.lens.width, height = flight->scenario().camera.rig.lens.height;
    EXPECT_EQ(c.width, width);
    EXPECT_NEAR(c.fx, sim::test::kSmall ? 225 : 450, 1e-9);
    EXPECT_NEAR(c.distortion[0], -0.12, 1e-9);
    if (std::string(layout).empty()) {
      EXPECT_NEAR(c.readout_frames, 0.015 * 30, 1e-6);
    }
    ASSERT_TRUE(c.T_body_cam.has_value());
    EXPECT_NEAR((*c.T_body_cam)[4], 1, 1e-9) << "the picture's right is the body's right";
    // Lossless pictures come back as they were rendered.
    std::vector<std::uint8_t> read(static_cast<std::size_t>(width * height)), made(read.size());
    hal::CapturedFrame frame, again;
    std::string why;
    ASSERT_EQ(camera.value()->next({read.data(), width, height, width}, nullptr, rt::kNsPerSecond, &frame, &why),
              hal::CameraStatus::kFrame)
        << why;
    const auto direct = flight->camera(0);
    direct->skip_to(150);
    ASSERT_EQ(direct->next({made.data(), width, height, width}, nullptr, 0, &again, &why), hal::CameraStatus::kFrame);
    EXPECT_EQ(read, made);
    EXPECT_EQ(frame.t_source_ns, again.t_source_ns + 1000 * rt::kNsPerSecond);
  }
}

TEST_F(FlightFolder, SaysWhatItCannotWrite) {
  fs::create_directories(folder_);
  std::ofstream(folder_ / "mav0") << "in the way";
  const auto written = write_flight(*flight, {folder_.string(), false, 0, 2}, stop_);
  ASSERT_FALSE(written.ok());
  EXPECT_THAT(written.error().message, testing::HasSubstr("cannot make the folder"));
  EXPECT_FALSE(fs::exists(folder_ / "rgb.txt"));
}

TEST_F(FlightFolder, AnInterruptedFlightIsNotWhole) {
  stop_ = true;
  const auto written = write_flight(*flight, {folder_.string(), false, 0, 2}, stop_);
  ASSERT_FALSE(written.ok());
  EXPECT_THAT(written.error().message, testing::HasSubstr("interrupted"));
  EXPECT_FALSE(fs::exists(folder_ / "rgb.txt"));
}

TEST_F(FlightFolder, NoPictureIsLeftBehindTheLast) {
  const auto written = write_flight(*flight, {folder_.string(), false, 100000, 2}, stop_);
  ASSERT_FALSE(written.ok());
  EXPECT_THAT(written.error().message, testing::HasSubstr("the flight has 1800 pictures"));
}

}  // namespace
}  // namespace godwit::app
