#include "firmware_app/flight/devices.h"

#include <filesystem>
#include <fstream>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sched.h>

#include "hal/rt/time.h"
#include "hal/rt/wake_up.h"
#include "tests/support/temp_folder.h"

namespace godwit::app {
namespace devices_test {

using ::testing::HasSubstr;

constexpr const char* kCalibration =
    "model: pinhole\nwidth: 640\nheight: 480\nfx: 450\nfy: 450\ncx: 320\ncy: 240\n"
    "distortion_model: none\ndistortion: []\nfps: 25\nshutter: rolling\nreadout_s: 0.02\n";

std::string mistakes(const std::string& toml) {
  ConfigReport report = parse_config(toml, "c.toml");
  check_devices(&report);
  std::string out;
  for (const std::string& m : report.mistakes) out += m + "\n";
  return out;
}

TEST(Devices, SettingsOfAV4l2CameraComeFromConfigurationAndCalibration) {
  const test::TempFolder folder;
  test::write_file(folder / "camera.yaml", kCalibration);
  const ConfigReport report =
      parse_config("[camera]\nsource = \"v4l2\"\ncalibration = \"" + (folder / "camera.yaml") +
                       "\"\ndevice = \"serial:42\"\nformat = \"RG10\"\nshift = 1\nstamp = \"start\"\nexposure_ms = 4\n"
                       "controls = \"exposure_auto=1, gain = -20\"\n",
                   "c.toml");
  ASSERT_TRUE(report.ok()) << report.mistakes.front();
  const auto calibration = hal::parse_calibration(kCalibration, "camera.yaml");
  ASSERT_TRUE(calibration.ok());
  const auto s = v4l2_settings(report.config.camera, calibration.value());
  ASSERT_TRUE(s.ok());
  EXPECT_EQ(s.value().device, "serial:42");
  EXPECT_EQ(s.value().width, 640);
  EXPECT_EQ(s.value().format, hal::PixelFormat::kRg10);
  EXPECT_EQ(s.value().fps, 25);
  EXPECT_EQ(s.value().shift, 1);
  EXPECT_EQ(s.value().stamp_at, hal::StampAt::kStartOfExposure);
  EXPECT_EQ(s.value().exposure_ns, 4 * rt::kNsPerMs);
  EXPECT_EQ(s.value().readout_ns, 20 * rt::kNsPerMs);
  EXPECT_TRUE(s.value().rolling);
  ASSERT_EQ(s.value().controls.size(), 2u);
  EXPECT_EQ(s.value().controls[1].first, "gain");
  EXPECT_EQ(s.value().controls[1].second, -20);
}

TEST(Devices, WhoSetsTheExposureComesFromTheConfiguration) {
  auto calibration = hal::parse_calibration(kCalibration, "camera.yaml");
  ASSERT_TRUE(calibration.ok());
  Config::Camera config;
  EXPECT_EQ(v4l2_settings(config, calibration.value()).value().exposure.mode, hal::ExposureMode::kOff);
  config.exposure = Config::Camera::Exposure::kFixed;
  config.exposure_ms = 2.5;
  config.gain = 4;
  hal::ExposurePlan plan = v4l2_settings(config, calibration.value()).value().exposure;
  EXPECT_EQ(plan.mode, hal::ExposureMode::kFixed);
  EXPECT_EQ(plan.fixed.exposure_ns, 2'500'000);
  EXPECT_EQ(plan.fixed.gain, 4);
  config.exposure = Config::Camera::Exposure::kAutomatic;
  config.exposure_unit_us = 18.9;
  plan = v4l2_settings(config, calibration.value()).value().exposure;
  EXPECT_EQ(plan.mode, hal::ExposureMode::kAutomatic);
  EXPECT_EQ(plan.automatic.focal_px, 450);
  EXPECT_EQ(plan.automatic.most_ns, 20 * rt::kNsPerMs) << "40 ms from frame to frame, 20 ms of readout";
  EXPECT_EQ(plan.exposure_unit_ns, 18'900);
  config.exposure_most_ms = 5;
  EXPECT_EQ(v4l2_settings(config, calibration.value()).value().exposure.automatic.most_ns, 5 * rt::kNsPerMs);
}

TEST(Devices, MistakesNameTheirKeyAndLine) {
  const test::TempFolder folder;
  test::write_file(folder / "camera.yaml", kCalibration);
  const std::string good = "[camera]\nsource = \"v4l2\"\ncalibration = \"" + (folder / "camera.yaml") + "\"\n";
  EXPECT_EQ(mistakes(good), "");
  EXPECT_THAT(mistakes(good + "[imu]\nsource = \"iio\"\n"),
              HasSubstr("c.toml: imu.enabled: neither camera.calibration nor link.T_body_cam says where"));
  EXPECT_EQ(mistakes(good + "[imu]\nsource = \"iio\"\nenabled = false\n"), "");
  EXPECT_EQ(
      mistakes(good +
               "[imu]\nsource = \"iio\"\n[link]\nT_body_cam = [0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1]\n"),
      "");
  EXPECT_THAT(mistakes("[camera]\nsource = \"v4l2\"\n"), HasSubstr("camera.calibration: a camera without one"));
  EXPECT_THAT(mistakes("[camera]\nsource = \"v4l2\"\ncalibration = \"/none\"\n"),
              HasSubstr("c.toml:3: camera.calibration: /none"));
  EXPECT_THAT(mistakes(good + "format = \"H264\"\n"), HasSubstr("c.toml:4: camera.format: GREY, NV12"));
  for (const char* wrong : {"gain", "gain=", "=3", "gain=x", "gain=3 4", "gain=3,,"}) {
    EXPECT_THAT(mistakes(good + "controls = \"" + wrong + "\"\n"), HasSubstr("c.toml:4: camera.controls: ")) << wrong;
  }
  EXPECT_EQ(mistakes("[imu]\nsource = \"mpu6000\"\n"), "");
  test::write_file(folder / "imu.yaml", "accelerometer_noise_density: 2e-3\n");
  EXPECT_EQ(mistakes("[imu]\ncalibration = \"" + (folder / "imu.yaml") + "\"\n"), "");
  EXPECT_THAT(
      mistakes("[imu]\ncalibration = \"" + (folder / "camera.yaml") + "\"\n"),
      HasSubstr("c.toml:2: imu.calibration: " + (folder / "camera.yaml") + ": none of gyroscope_noise_density"));
  EXPECT_THAT(mistakes("[imu]\nsource = \"iio\"\naxes = \"x y\"\n"), HasSubstr("c.toml:3: imu.axes: "));
  EXPECT_THAT(mistakes("[imu]\nsource = \"mpu6000\"\nrate_hz = 300\n"), HasSubstr("c.toml:3: imu.rate_hz: "));
  EXPECT_THAT(mistakes("[imu]\nsource = \"mpu6000\"\naccel_range_g = 3\n"), HasSubstr("imu.accel_range_g: 2, 4, 8"));
  EXPECT_THAT(mistakes("[imu]\nsource = \"mpu6000\"\ngyro_range_deg_s = 300\n"), HasSubstr("imu.gyro_range_deg_s: "));
}

TEST(Devices, LibcameraIsAskedForByNumberOrIdAndExposesByItself) {
  const test::TempFolder folder;
  test::write_file(folder / "camera.yaml", kCalibration);
  const std::string good =
      "[camera]\nsource = \"libcamera\"\ndevice = \"index:0\"\ncalibration = \"" + (folder / "camera.yaml") + "\"\n";
  const std::string built =
      std::filesystem::exists(hal::libcamera_library())
          ? ""
          : "c.toml:2: camera.source: \"libcamera\": this godwit was built without it (libcamera-dev "
            "was not there; " +
                hal::libcamera_library() + " is missing); \"v4l2\" is allowed\n";
  EXPECT_EQ(mistakes(good), built);
  EXPECT_EQ(mistakes(good + "exposure = \"fixed\"\nexposure_ms = 4\n"), built);
  EXPECT_THAT(mistakes(good + "exposure = \"automatic\"\n"), HasSubstr("c.toml:5: camera.exposure: with libcamera"));
  EXPECT_THAT(mistakes(good + "controls = \"gain=3\"\n"), HasSubstr("c.toml:5: camera.controls: V4L2's"));
  EXPECT_THAT(mistakes(good + "format = \"H264\"\n"), HasSubstr("c.toml:5: camera.format: GREY, NV12"));
  EXPECT_THAT(mistakes("[camera]\nsource = \"libcamera\"\ncalibration = \"" + (folder / "camera.yaml") + "\"\n"),
              HasSubstr("camera.device: with libcamera \"index:0\""));
  EXPECT_THAT(mistakes("[camera]\nsource = \"libcamera\"\n"), HasSubstr("camera.calibration: a camera without one"));
}

TEST(Devices, WhatIsNotThereIsToldAndNoReasonNotToStart) {
  const test::TempFolder folder;
  test::write_file(folder / "camera.yaml", kCalibration);
  Config config;
  config.camera.source = Config::Camera::Source::kV4l2;
  config.camera.calibration = folder / "camera.yaml";
  config.camera.device = "/dev/no-such-camera";
  std::string told;
  const DeviceLog log = [&](const std::string& text) { told += text + "\n"; };
  auto camera = open_camera(config.camera, log);
  ASSERT_TRUE(camera.ok());
  EXPECT_THAT(told, HasSubstr("warning: camera: /dev/no-such-camera: cannot be opened: No such file or directory"));
  config.imu.source = Config::Imu::Source::kMpu6000;
  config.imu.device = "/dev/no-such-bus";
  auto imu = open_imu(config.imu, log);
  ASSERT_TRUE(imu.ok());
  EXPECT_THAT(told, HasSubstr("warning: IMU /dev/no-such-bus: the SPI device cannot be opened"));
  config.imu.source = Config::Imu::Source::kIio;
  config.imu.device = "no-such-sensor";
  imu = open_imu(config.imu, log);
  ASSERT_TRUE(imu.ok());
  EXPECT_THAT(told, HasSubstr("warning: IMU: iio: "));
}

/// The processors that the thread of this name may run on; empty: there is none.
std::string processors_of(const std::string& name) {
  for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
    std::ifstream comm(task.path() / "comm"), status(task.path() / "status");
    std::string word;
    std::getline(comm, word);
    if (word != name) continue;
    while (status >> word) {
      if (word == "Cpus_allowed_list:" && status >> word) return word;
    }
  }
  return {};
}

TEST(Devices, MjpegIsDecodedWhereTheConfigurationSaysAndNotOnTheTrackersProcessor) {
  const test::TempFolder folder;
  test::write_file(folder / "camera.yaml", kCalibration);
  Config config;
  config.camera.source = Config::Camera::Source::kV4l2;
  config.camera.calibration = folder / "camera.yaml";
  config.camera.device = "/dev/no-such-camera";
  config.camera.format = "MJPG";
  cpu_set_t mine;
  ASSERT_EQ(sched_getaffinity(0, sizeof mine, &mine), 0);
  int last = 0;
  for (int cpu = 0; cpu < CPU_SETSIZE; ++cpu) last = CPU_ISSET(cpu, &mine) ? cpu : last;
  rt::ThreadPlan plan;
  plan.cpus = {last};
  const auto camera = open_camera(
      config.camera, [](const std::string&) {}, plan);
  ASSERT_TRUE(camera.ok());
  EXPECT_TRUE(camera.value().camera->real_time());
  std::string where;
  // The thread names itself once it runs.
  for (int i = 0; i < 6000 && where != std::to_string(last); ++i) {
    where = processors_of("gw-feeder");
    rt::sleep_until_ns(rt::monotonic_now_ns() + 5 * rt::kNsPerMs);
  }
  EXPECT_EQ(where, std::to_string(last));
}

}  // namespace devices_test
}  // namespace godwit::app
