// `godwit calibrate` as a user runs it: drawn boards and a made-up sensor in, calibrations out.
#include <cstdlib>
#include <filesystem>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>
#include <random>

#include "tests/app/drawn_board.h"
#include "tests/support/run_command.h"
#include "tests/support/temp_folder.h"

namespace godwit::app {
namespace {

using Distortion = hal::CameraCalibration::Distortion;
using test::Outcome;
using test::read_file;
using testing::HasSubstr;

constexpr const char* kBoard = "aprilgrid:6x6:0.055:0.3";

Outcome calibrate(const std::string& arguments) {
  return test::run_command("'" GODWIT_TOOL "' calibrate " + arguments);
}

/// "key: value" of Kalibr's imu.yaml.
double value_of(const std::string& yaml, const std::string& key) {
  const std::size_t at = yaml.find(key + ": ");
  return at == std::string::npos ? 0 : std::atof(yaml.c_str() + at + key.size() + 2);
}

class CalibrateCamera : public testing::Test {
 protected:
  void draw(const std::string& name, const hal::CameraCalibration& c, const std::function<drawn::BoardPose(int)>& at) {
    if (!renderer_) renderer_.emplace(board_, c);
    std::filesystem::create_directories(std::filesystem::path(folder_ / name).parent_path());
    ASSERT_TRUE(cv::imwrite(folder_ / name, renderer_->picture(at, ++seed_)));
  }
  hal::CameraCalibration written() const {
    const auto read = hal::parse_calibration(read_file(folder_ / "camera.toml"), "camera.toml");
    EXPECT_TRUE(read.ok()) << (read.ok() ? "" : read.error().message);
    return read.ok() ? read.value() : hal::CameraCalibration();
  }
  static void expect_like(const hal::CameraCalibration& found, const hal::CameraCalibration& truth) {
    EXPECT_NEAR(found.fx / truth.fx, 1, 0.002);
    EXPECT_NEAR(found.fy / truth.fy, 1, 0.002);
    EXPECT_EQ(found.distortion_model, truth.distortion_model);
    std::printf("fx %+.4f %%, fy %+.4f %%\n", 100 * (found.fx / truth.fx - 1), 100 * (found.fy / truth.fy - 1));
  }
  const test::TempFolder folder_;
  const Board board_ = parse_board(kBoard).value();
  std::optional<drawn::Renderer> renderer_;
  std::uint64_t seed_ = 0;
};

class CalibrateCameraModels : public CalibrateCamera, public testing::WithParamInterface<Distortion> {};

TEST_P(CalibrateCameraModels, AFolderOfDrawnBoardsGivesTheFocalLengthWithinTwoThousandths) {
  const hal::CameraCalibration truth = drawn::camera(GetParam());
  for (int i = 0; i < 24; ++i) {
    const drawn::BoardPose p = drawn::shown(board_, truth, i);
    draw("pictures/" + std::to_string(100 + i) + ".png", truth, [&](int) { return p; });
  }
  const Outcome o = calibrate("camera '" + folder_ / "pictures" + "' --board " + kBoard + " --model " +
                              (GetParam() == Distortion::kRadTan ? "radtan" : "equidistant") + " --out '" +
                              folder_ / "camera.toml" + "'");
  EXPECT_EQ(o.exit_code, 0) << o.text;
  EXPECT_THAT(o.text, HasSubstr("verdict: good"));
  EXPECT_THAT(o.text, HasSubstr("readout: the motion does not show it"));
  expect_like(written(), truth);
}

INSTANTIATE_TEST_SUITE_P(Models, CalibrateCameraModels,
                         testing::Values(Distortion::kRadTan, Distortion::kKannalaBrandt4), [](const auto& model) {
                           return std::string(model.param == Distortion::kRadTan ? "radtan" : "equidistant");
                         });

// As godwit record writes it: the board held still here and there, then the camera swung before it.
TEST_F(CalibrateCamera, ARecordingWithARollingShutterGivesItsReadoutWithinATenth) {
  constexpr double kReadoutS = 0.02;
  const hal::CameraCalibration truth = drawn::camera(Distortion::kRadTan);
  const auto name = [](rt::TimeNs t_ns) { return "record/mav0/cam0/data/" + std::to_string(t_ns) + ".png"; };
  constexpr rt::TimeNs kBegin = 1'600'000'000 * rt::kNsPerSecond;
  for (int i = 0; i < 24; ++i) {
    const drawn::BoardPose p = drawn::shown(board_, truth, i);
    draw(name(kBegin + i * rt::kNsPerSecond), truth, [&](int) { return p; });
  }
  for (int i = 0; i < 24; ++i) {
    draw(name(kBegin + 60 * rt::kNsPerSecond + i * 33'333'333LL), truth,
         [&](int row) { return drawn::swung(board_, truth, kReadoutS, i, row); });
  }
  const Outcome o = calibrate("camera '" + folder_ / "record" + "' --board " + kBoard + " --fps 30 --out '" +
                              folder_ / "camera.toml" + "'");
  EXPECT_EQ(o.exit_code, 0) << o.text;
  EXPECT_THAT(o.text, HasSubstr("a rolling shutter"));
  expect_like(written(), truth);
  EXPECT_THAT(o.text, HasSubstr("verdict: good"));
  EXPECT_NEAR(written().readout_s(), kReadoutS, 0.1 * kReadoutS);
  std::printf("readout %.2f ms, true %.2f\n", 1e3 * written().readout_s(), 1e3 * kReadoutS);
}

TEST_F(CalibrateCamera, WhatCannotBeDoneIsToldAndNothingWritten) {
  const hal::CameraCalibration truth = drawn::camera(Distortion::kRadTan);
  for (int i = 0; i < 3; ++i) {
    const drawn::BoardPose p = drawn::shown(board_, truth, i);
    draw("few/" + std::to_string(i) + ".png", truth, [&](int) { return p; });
  }
  const std::string out = " --out '" + folder_ / "camera.toml" + "'";
  Outcome o = calibrate("camera '" + folder_ / "few" + "' --board " + kBoard + out);
  EXPECT_EQ(o.exit_code, 1);
  EXPECT_THAT(o.text, HasSubstr("the board was found in 3 pictures"));
  o = calibrate("camera '" + folder_ / "few" + "' --board chessboard:8x6:0.045" + out);
  EXPECT_EQ(o.exit_code, 1);
  EXPECT_THAT(o.text, HasSubstr("the board was found in 0 pictures"));
  o = calibrate("camera '" + folder_ / "nowhere" + "' --board " + kBoard + out);
  EXPECT_EQ(o.exit_code, 2);
  EXPECT_THAT(o.text, HasSubstr("No such file or directory"));
  o = calibrate(std::string("camera --board ") + kBoard + out);
  EXPECT_EQ(o.exit_code, 2);
  EXPECT_THAT(o.text, HasSubstr("--config and --size for the live camera, is needed"));
  o = calibrate(std::string("camera --fps nan --board ") + kBoard + out);
  EXPECT_EQ(o.exit_code, 2);
  EXPECT_THAT(o.text, HasSubstr("--fps: 'nan': numbers from 0.001 to 1000 are allowed"));
  EXPECT_FALSE(std::filesystem::exists(folder_ / "camera.toml"));
}

TEST(CalibrateImu, AStillRecordingGivesTheNoiseFiguresWithinATenth) {
  constexpr double kRateHz = 50, kSeconds = 7200;
  constexpr double kGyro = 1e-4, kGyroWalk = 4e-5, kAccel = 2e-3, kAccelWalk = 6e-4;
  const test::TempFolder folder;
  std::mt19937_64 random(11);
  std::normal_distribution<double> normal;
  std::array<double, 6> bias{};
  std::string csv = "#timestamp [ns],w_x,w_y,w_z,a_x,a_y,a_z\n";
  csv.reserve(40'000'000);
  for (int i = 0; i < static_cast<int>(kSeconds * kRateHz); ++i) {
    csv += std::to_string(1'600'000'000 * rt::kNsPerSecond + i * 20 * rt::kNsPerMs);
    for (std::size_t a = 0; a < 6; ++a) {
      bias[a] += (a < 3 ? kGyroWalk : kAccelWalk) / std::sqrt(kRateHz) * normal(random);
      const double noise = (a < 3 ? kGyro : kAccel) * std::sqrt(kRateHz) * normal(random);
      std::array<char, 32> text{};
      std::snprintf(text.data(), text.size(), ",%.9g", bias[a] + noise - (a == 5 ? 9.81 : 0));
      csv += text.data();
    }
    csv += '\n';
  }
  test::write_file(folder / "record/mav0/imu0/data.csv", csv);
  const Outcome o = calibrate("imu '" + folder / "record" + "' --out '" + folder / "imu.yaml" + "' --plot '" +
                              folder / "allan.svg" + "'");
  ASSERT_EQ(o.exit_code, 0) << o.text;
  const std::string yaml = read_file(folder / "imu.yaml");
  for (const auto& [key, truth] : {std::pair{"gyroscope_noise_density", kGyro},
                                   {"gyroscope_random_walk", kGyroWalk},
                                   {"accelerometer_noise_density", kAccel},
                                   {"accelerometer_random_walk", kAccelWalk}}) {
    EXPECT_NEAR(value_of(yaml, key) / truth, 1, 0.1) << key;
    std::printf("%s %+.1f %%\n", key, 100 * (value_of(yaml, key) / truth - 1));
  }
  EXPECT_THAT(read_file(folder / "allan.svg"), testing::StartsWith("<svg "));
}

}  // namespace
}  // namespace godwit::app
