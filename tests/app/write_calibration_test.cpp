// Rotation and time between camera and inertial sensor from a rendered flight, as a user asks for them, and flown by.
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <sstream>

#include "hal/camera/calibration.h"
#include "tests/support/run_command.h"
#include "tests/support/temp_folder.h"
#include "vo_core/geometry/geometry.h"

namespace {

using godwit::test::Outcome;
using godwit::test::read_file;
using godwit::test::TempFolder;
using godwit::test::write_file;
using testing::HasSubstr;

/// In bends, swaying; a rolling shutter, and pictures stamped 15 ms late.
constexpr const char* kBends = R"(
max_duration_s = 13
[world]
kind = "residential"
ground_texels = 512
[flight]
start_m = [22, 102.4]
start_height_m = 8
sway = 3
[[flight.leg]]
kind = "path"
speed_m_s = 4
points_m = [[40, 104.4], [50, 99], [60, 105], [70, 99], [90, 104]]
[camera]
width = 320
height = 240
fx = 225
pitch_down_deg = 40
time_offset_ms = 15
position_m = [0.08, 0.0, 0.04]
readout_ms = 15
)";

Outcome godwit(const std::string& arguments) {
  return godwit::test::run_command("'" GODWIT_TOOL "' " + arguments);
}

Eigen::Matrix3d rotation(const std::array<double, 16>& T) {
  return Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(T.data()).topLeftCorner<3, 3>();
}

/// The time offset as it is told in flight, of the last line [s].
double told_offset(const std::string& pose_csv) {
  const std::string text = read_file(pose_csv);
  std::istringstream names(text.substr(0, text.find('\n'))), values(text.substr(text.rfind('\n', text.size() - 2) + 1));
  std::string name, value;
  while (std::getline(names, name, ',') && std::getline(values, value, ',')) {
    if (name == "time_offset") return std::atof(value.c_str());
  }
  ADD_FAILURE() << pose_csv << " has no time_offset";
  return 0;
}

TEST(WriteCalibration, ARenderedFlightGivesTheTimeOffsetWithinAMillisecondAndIsFlownByIt) {
  const TempFolder folder;
  write_file(folder / "bends.toml", kBends);
  const std::string flight = folder / "flight", file = folder / "camera.toml";
  ASSERT_EQ(godwit("sim '" + folder / "bends.toml" + "' --start 30 --out '" + flight + "'").exit_code, 0);
  const auto replay = [&](const std::string& more) {
    return godwit("replay '" + flight + "' --sequential --out '" + folder / "run" + "' " + more);
  };
  const auto before = godwit::hal::parse_calibration(read_file(flight + "/camera.yaml"), "camera.yaml");
  ASSERT_TRUE(before.ok());
  const Eigen::Matrix3d mounting = rotation(*before.value().T_body_cam);

  // By vision alone: then not even a mounting need be known.
  std::string yaml = read_file(flight + "/camera.yaml");
  const std::size_t key = yaml.find("T_body_cam");
  std::string unmounted = yaml;
  unmounted.erase(key, yaml.find('\n', key) - key);
  write_file(flight + "/camera.yaml", unmounted);
  Outcome o = replay("--imu watch --write-calibration '" + file + "'");
  ASSERT_EQ(o.exit_code, 0) << o.text;
  EXPECT_THAT(o.text, HasSubstr("measure it by ruler"));
  const auto after = godwit::hal::parse_calibration(read_file(file), "camera.toml");
  ASSERT_TRUE(after.ok()) << after.error().message;
  EXPECT_NEAR(after.value().time_offset_s.value_or(0), -0.015, 1e-3);
  const double off = godwit::vo::so3_log(mounting.transpose() * rotation(*after.value().T_body_cam)).norm();
  EXPECT_LT(off, 0.006);
  EXPECT_EQ(after.value().fx, before.value().fx);
  EXPECT_NEAR(after.value().readout_s(), 0.015, 1e-9);
  std::printf("time offset %+.2f ms, true -15; rotation off by %.2f degrees\n",
              1e3 * after.value().time_offset_s.value_or(0), off * 180 / M_PI);

  // The same with the inertial sensor's help, and what was found is flown by.
  write_file(flight + "/camera.yaml", yaml);
  o = replay("--imu on --write-calibration '" + file + "'");
  ASSERT_EQ(o.exit_code, 0) << o.text;
  EXPECT_THAT(o.text, HasSubstr("the rotation differs by"));
  const auto again = godwit::hal::parse_calibration(read_file(file), "camera.toml");
  ASSERT_TRUE(again.ok());
  EXPECT_NEAR(again.value().time_offset_s.value_or(0), -0.015, 1e-3);
  write_file(flight + "/camera.yaml", yaml + "time_offset_s: " + std::to_string(*again.value().time_offset_s) + "\n");
  ASSERT_EQ(replay("--imu on").exit_code, 0);
  EXPECT_NEAR(told_offset(folder / "run/pose.csv"), -0.015, 1e-3);
}

TEST(WriteCalibration, NeedsAnInertialSensorAndTurns) {
  const TempFolder folder;
  write_file(folder / "bends.toml", kBends);
  const std::string flight = folder / "flight", file = folder / "camera.toml";
  ASSERT_EQ(godwit("sim '" + folder / "bends.toml" + "' --start 30 --frames 40 --out '" + flight + "'").exit_code, 0);
  const std::string replay =
      "replay '" + flight + "' --sequential --out '" + folder / "run" + "' --write-calibration '" + file + "'";
  Outcome o = godwit(replay);
  EXPECT_EQ(o.exit_code, 2);
  EXPECT_THAT(o.text, HasSubstr("add --imu on or --imu watch"));
  o = godwit(replay + " --imu watch");
  EXPECT_EQ(o.exit_code, 1);
  EXPECT_THAT(o.text, HasSubstr("60 at least are needed"));
  EXPECT_FALSE(std::filesystem::exists(file));
}

}  // namespace
