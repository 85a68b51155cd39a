#include "hal/imu/error_model.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <vector>

#include "hal/imu/replay/imu_record.h"
#include "tests/support/temp_folder.h"

namespace godwit::hal::error_model_test {
namespace {

using testing::HasSubstr;

constexpr const char* kEuroc =
    "%YAML:1.0\nsensor_type: imu\nT_BS:\n  cols: 4\n  rows: 4\n  data: [1.0, 0.0]\nrate_hz: 200\n"
    "gyroscope_noise_density: 1.6968e-04\ngyroscope_random_walk: 1.9393e-05\n"
    "accelerometer_noise_density: 2.0000e-3\naccelerometer_random_walk: 3.0000e-3\n";

TEST(ImuErrorModel, ReadsWhatKalibrAndEurocWrite) {
  const auto r = parse_imu_error_model(kEuroc, "sensor.yaml");
  ASSERT_TRUE(r.ok()) << r.error().message;
  EXPECT_DOUBLE_EQ(r.value().gyroscope_noise_density.value(), 1.6968e-4);
  EXPECT_DOUBLE_EQ(r.value().gyroscope_random_walk.value(), 1.9393e-5);
  EXPECT_DOUBLE_EQ(r.value().accelerometer_noise_density.value(), 2e-3);
  EXPECT_DOUBLE_EQ(r.value().accelerometer_random_walk.value(), 3e-3);
  EXPECT_FALSE(r.value().accelerometer_bias_sigma) << "nobody says it";
  EXPECT_FALSE(r.value().empty());
}

TEST(ImuErrorModel, WhatNoSensorHasIsRefusedWithItsLine) {
  for (const char* value : {"0", "-1e-4", "5", ".nan", ".inf", "much", "[1e-4]"}) {
    const auto r =
        parse_imu_error_model("rate_hz: 200\ngyroscope_noise_density: " + std::string(value) + "\n", "imu.yaml");
    ASSERT_FALSE(r.ok()) << value;
    EXPECT_EQ(r.error().message,
              "imu.yaml:2: gyroscope_noise_density: a number from 1e-07 to 0.1 [rad/s/sqrt(Hz)] is wanted")
        << value;
  }
  EXPECT_FALSE(parse_imu_error_model("gyroscope_noise_density:\n", "imu.yaml").ok()) << "nothing stands there";
  EXPECT_THAT(parse_imu_error_model("a: [1", "imu.yaml").error().message, HasSubstr(": not YAML: "));
  EXPECT_THAT(parse_imu_error_model("- 1\n", "imu.yaml").error().message, HasSubstr("not a list of 'key: value'"));
}

TEST(ImuErrorModel, AFileThatSaysNothingOfASensorIsRefused) {
  const test::TempFolder folder;
  test::write_file(folder / "camera.yaml", "model: pinhole\n");
  EXPECT_THAT(read_imu_error_model(folder / "camera.yaml").error().message,
              HasSubstr("camera.yaml: none of gyroscope_noise_density, accelerometer_noise_density, .. is there"));
  EXPECT_THAT(read_imu_error_model(folder / "absent.yaml").error().message, HasSubstr("absent.yaml"));
}

TEST(ImuErrorModel, GoesWithTheRecordingItLiesBeside) {
  const test::TempFolder folder;
  test::write_file(folder / "mav0/imu0/data.csv", "1000,0,0,0,0,0,9.8\n2000,0,0,0,0,0,9.8\n");
  const auto without = read_imu_record(folder.path());
  ASSERT_TRUE(without.ok()) << without.error().message;
  EXPECT_TRUE(without.value().errors.empty());
  test::write_file(folder / "mav0/imu0/sensor.yaml", kEuroc);
  EXPECT_EQ(read_imu_record(folder.path()).value().errors.accelerometer_noise_density, 2e-3);
  EXPECT_EQ(read_imu_record_errors(folder.path()).value().accelerometer_noise_density, 2e-3);
  test::write_file(folder / "imu.txt", "1.0 0 0 0 0 0 0\n");
  test::write_file(folder / "imu.yaml", "accelerometer_noise_density: 1e-2\n");
  EXPECT_EQ(read_imu_record(folder.path()).value().errors.accelerometer_noise_density, 1e-2) << "beside rgb.txt";
  test::write_file(folder / "imu.yaml", "accelerometer_noise_density: 100\n");
  EXPECT_THAT(read_imu_record(folder.path()).error().message, HasSubstr("imu.yaml:1: accelerometer_noise_density"))
      << "a unit gone wrong is not flown with";
}

TEST(ImuErrorModel, ReadingsAtTheEndsOfTheRangesItNamesAreFlagged) {
  const test::TempFolder folder;
  // 16 bits of 4 g and 500 deg/s; the last one of 12 bits.
  test::write_file(folder / "imu.txt",
                   "1.0 0 0 8.7 0 0 -9.8\n1.1 0 0 8.726379 0 0 -9.8\n1.2 0 0 0 39.22 -39.2254 0\n"
                   "1.3 8.7224 0 0 0 39.2075 0\n");
  const auto flags = [&] {
    std::vector<int> out;
    const auto record = read_imu_record(folder.path());
    for (const ImuSample& s : record.value().samples) out.push_back(s.flags);
    return out;
  };
  EXPECT_THAT(flags(), testing::ElementsAre(0, 0, 0, 0)) << "nobody knows";
  test::write_file(folder / "imu.yaml", "gyroscope_range: 8.726646\naccelerometer_range: 39.2266\n");
  EXPECT_THAT(flags(),
              testing::ElementsAre(0, kImuGyroSaturated, kImuAccelSaturated, kImuGyroSaturated | kImuAccelSaturated));
  EXPECT_EQ(read_imu_record(folder.path()).value().saturated, 3u);
  EXPECT_THAT(read_imu_record(folder.path()).value().warnings("flight"),
              testing::Contains("flight: the inertial sensor is at the end of its range in 3 of 4 readings"));
  test::write_file(folder / "imu.yaml", "accelerometer_range: 4\n");
  EXPECT_THAT(read_imu_record(folder.path()).error().message,
              HasSubstr("accelerometer_range: a number from 10 to 1000"))
      << "those are g";
}

}  // namespace
}  // namespace godwit::hal::error_model_test
