#include "hal/camera/calibration.h"

#include <cstdlib>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "hal/camera/calibration_toml.h"
#include "tests/support/temp_folder.h"

namespace godwit::hal::calibration_test {
namespace {

using testing::HasSubstr;

const char* const kOwn =
    "# pinhole camera\nmodel: pinhole\nwidth: 640\nheight: 480\nfx: 517.3\nfy: 516.5\ncx: 318.6\ncy: 255.3\n"
    "distortion_model: radtan (k1 k2 p1 p2 k3)\ndistortion: [0.262383, -0.953104, -0.005358, 0.002628, 1.163314]\n"
    "fps: 30\nimage_channels: 3\n";

const char* const kEuroc =
    "sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [0, -1, 0, 0.1,\n         1, 0, 0, 0.2,\n"
    "         0, 0, 1, 0.3,\n         0.0, 0.0, 0.0, 1.0]\nrate_hz: 20\nresolution: [752, 480]\n"
    "camera_model: pinhole\nintrinsics: [458.654, 457.296, 367.215, 248.375] #fu, fv, cu, cv\n"
    "distortion_model: radial-tangential\n"
    "distortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]\n";

std::string with(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

std::string refusal(const std::string& text) {
  const auto c = parse_calibration(text, "camera.yaml");
  EXPECT_FALSE(c.ok()) << text;
  return c.ok() ? "" : c.error().message;
}

TEST(Calibration, ReadsOurOwnFile) {
  const auto c = parse_calibration(kOwn, "camera.yaml");
  ASSERT_TRUE(c.ok()) << c.error().message;
  EXPECT_EQ(c.value().width, 640);
  EXPECT_EQ(c.value().height, 480);
  EXPECT_EQ(c.value().fx, 517.3);
  EXPECT_EQ(c.value().distortion_model, CameraCalibration::Distortion::kRadTan);
  EXPECT_EQ(c.value().distortion[4], 1.163314);
  EXPECT_EQ(c.value().channels, 3);
  EXPECT_EQ(c.value().fps, 30);
  EXPECT_FALSE(c.value().T_body_cam.has_value());
}

TEST(Calibration, ReadsEurocsSensorFile) {
  const auto c = parse_calibration(kEuroc, "sensor.yaml");
  ASSERT_TRUE(c.ok()) << c.error().message;
  EXPECT_EQ(c.value().width, 752);
  EXPECT_EQ(c.value().cy, 248.375);
  EXPECT_EQ(c.value().distortion[3], 1.76187114e-05);
  EXPECT_EQ(c.value().distortion[4], 0);
  EXPECT_EQ(c.value().channels, 1);
  ASSERT_TRUE(c.value().T_body_cam.has_value());
  EXPECT_EQ((*c.value().T_body_cam)[7], 0.2);
}

TEST(Calibration, ReadsTheFisheyeModel) {
  const auto c =
      parse_calibration(with(with(kEuroc, "radial-tangential", "equidistant"), "458.654", "258"), "sensor.yaml");
  ASSERT_TRUE(c.ok()) << c.error().message;
  EXPECT_EQ(c.value().distortion_model, CameraCalibration::Distortion::kKannalaBrandt4);
}

TEST(Calibration, ReadsTheShutter) {
  const auto readout = [](const std::string& more) {
    const auto c = parse_calibration(kOwn + more, "camera.yaml");
    EXPECT_TRUE(c.ok()) << c.error().message;
    return c.ok() ? c.value().readout_frames : -1.0;
  };
  EXPECT_EQ(readout(""), 0.0);
  EXPECT_EQ(readout("shutter: global\n"), 0.0);
  EXPECT_EQ(readout("shutter: rolling (Kinect v1)\n"), kTypicalReadout);
  EXPECT_DOUBLE_EQ(readout("shutter: rolling\nreadout_s: 0.020\n"), 0.6);
  EXPECT_THAT(refusal(std::string(kOwn) + "shutter: leaf\n"), HasSubstr("known are global and rolling"));
  EXPECT_THAT(refusal(std::string(kOwn) + "readout_s: 0.05\n"), HasSubstr("between 0 and 1 / fps"));
  EXPECT_THAT(refusal(with(kOwn, "fps: 30\n", "") + "readout_s: 0.02\n"), HasSubstr("needs fps"));
}

TEST(Calibration, RefusesWithFileLineKeyAndReason) {
  EXPECT_EQ(refusal(with(kOwn, "fx: 517.3\n", "")), "camera.yaml: fx is missing");
  EXPECT_EQ(refusal(with(kOwn, "fx: 517.3", "fx: wide")), "camera.yaml:5: fx: a number is wanted");
  EXPECT_EQ(refusal(with(kOwn, "fx: 517.3", "fx: .nan")), "camera.yaml:5: fx: the number is not finite");
  EXPECT_EQ(refusal(with(kOwn, "fx: 517.3", "fx: .inf")), "camera.yaml:5: fx: the number is not finite");
  EXPECT_THAT(refusal(with(kOwn, "fx: 517.3", "fx: 0")), HasSubstr("fx: absurd"));
  EXPECT_THAT(refusal(with(kOwn, "fx: 517.3", "fx: -517.3")), HasSubstr("fx: absurd"));
  EXPECT_THAT(refusal(with(kOwn, "fy: 516.5", "fy: 51.65")), HasSubstr("fy: differs from fx"));
  EXPECT_THAT(refusal(with(kOwn, "cx: 318.6", "cx: 700")), HasSubstr("cx: the centre lies outside"));
  EXPECT_THAT(refusal(with(kOwn, "width: 640", "width: 0")), HasSubstr("camera.yaml:3: width: a whole number from 64"));
  EXPECT_THAT(refusal(with(kOwn, "width: 640", "width: 640.5")), HasSubstr("width: a whole number"));
  EXPECT_THAT(refusal(with(kOwn, "width: 640", "width: 1e9")), HasSubstr("width: a whole number"));
  EXPECT_THAT(refusal(with(kOwn, "model: pinhole", "model: spherical")), HasSubstr("model: 'pinhole' is wanted"));
  EXPECT_THAT(refusal(with(kOwn, "radtan (k1 k2 p1 p2 k3)", "division")),
              HasSubstr("'division' is unknown; known are"));
  EXPECT_THAT(refusal(with(kOwn, ", 1.163314]", ", 1.16, 2.0]")), HasSubstr("distortion: 4 (k1 k2 p1 p2) or 5"));
  EXPECT_THAT(refusal(with(kOwn, "1.163314", "1e6")), HasSubstr("beyond 100"));
  EXPECT_THAT(refusal(with(kOwn, "image_channels: 3", "image_channels: 2")),
              HasSubstr("image_channels: 1 (grey) or 3"));
  EXPECT_THAT(refusal(with(kOwn, "fps: 30", "fps: -30")), HasSubstr("frame rate"));
  EXPECT_THAT(refusal(with(kEuroc, "1, 0, 0, 0.2", "2, 0, 0, 0.2")), HasSubstr("T_BS: not a rigid motion"));
  EXPECT_THAT(refusal(with(kEuroc, "resolution: [752, 480]", "resolution: 752")), HasSubstr("resolution: a list"));
}

TEST(Calibration, RefusesWhatIsNoCalibrationAtAll) {
  EXPECT_THAT(refusal(""), HasSubstr("camera.yaml: not a list of 'key: value' lines"));
  EXPECT_THAT(refusal("just words"), HasSubstr("not a list"));
  EXPECT_THAT(refusal("a: 1\n"), HasSubstr("neither 'model'"));
  EXPECT_THAT(refusal("a: [1, 2\nb: }"), HasSubstr("not YAML"));
  EXPECT_THAT(refusal(std::string(100000, '[')), HasSubstr("camera.yaml"));
  EXPECT_THAT(refusal("model: [pinhole]\n"), HasSubstr("model: a text is wanted"));
}

constexpr const char* kKalibr = R"(cam0:
  T_cam_imu:
  - [0.0, -1.0, 0.0, 0.1]
  - [1.0, 0.0, 0.0, 0.2]
  - [0.0, 0.0, 1.0, 0.3]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0002, 1.8e-05]
  distortion_model: radtan
  intrinsics: [458.6, 457.3, 367.2, 248.4]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
  timeshift_cam_imu: -0.0042
cam1:
  camera_model: pinhole
)";

constexpr const char* kRos = R"(image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [437.4, 0, 345.9, 0, 430.4, 216.0, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.36, 0.1, -0.001, 0.0006, 0]
)";

constexpr const char* kOpenCv = R"(%YAML:1.0
---
calibration_time: "Sun"
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.2e+02, 0., 3.2e+02, 0., 5.21e+02, 2.4e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ 0.01, -0.02, 0., 0.001, 0.3 ]
)";

CameraCalibration good(const std::string& text) {
  const auto c = parse_calibration(text, "camera.yaml");
  EXPECT_TRUE(c.ok()) << c.error().message;
  return c.ok() ? c.value() : CameraCalibration();
}

TEST(Calibration, ReadsKalibrsChain) {
  const CameraCalibration c = good(kKalibr);
  EXPECT_EQ(c.width, 752);
  EXPECT_EQ(c.fy, 457.3);
  EXPECT_EQ(c.distortion[3], 1.8e-05);
  EXPECT_EQ(c.distortion_model, CameraCalibration::Distortion::kRadTan);
  EXPECT_EQ(c.time_offset_s, -0.0042);
  // The inverse of T_cam_imu: the rotation's transpose, and minus that times the translation.
  ASSERT_TRUE(c.T_body_cam);
  const std::array<double, 16> want{0, 1, 0, -0.2, -1, 0, 0, 0.1, 0, 0, 1, -0.3, 0, 0, 0, 1};
  for (std::size_t i = 0; i < 16; ++i) EXPECT_DOUBLE_EQ((*c.T_body_cam)[i], want[i]) << i;
  const std::string fisheye = with(kKalibr, "distortion_model: radtan", "distortion_model: equidistant");
  EXPECT_EQ(good(fisheye).distortion_model, CameraCalibration::Distortion::kKannalaBrandt4);
  EXPECT_THAT(refusal(with(kKalibr, "pinhole\n  dist", "omni\n  dist")), HasSubstr("camera.yaml:8: camera_model"));
  EXPECT_THAT(refusal(with(kKalibr, "-1.0, 0.0, 0.1", "-1.1, 0.0, 0.1")), HasSubstr("T_cam_imu: not a rigid motion"));
  EXPECT_THAT(refusal("cam0: 3\n"), HasSubstr("cam0: a map of keys"));
}

TEST(Calibration, ReadsRosAndOpenCv) {
  const CameraCalibration ros = good(kRos);
  EXPECT_EQ(ros.width, 640);
  EXPECT_EQ(ros.fx, 437.4);
  EXPECT_EQ(ros.cy, 216.0);
  EXPECT_EQ(ros.distortion[0], -0.36);
  EXPECT_THAT(refusal(with(kRos, "plumb_bob", "rational_polynomial")), HasSubstr("'rational_polynomial' is unknown"));
  EXPECT_THAT(refusal(with(kRos, "437.4, 0,", "437.4, 2,")), HasSubstr("skew is not supported"));
  const CameraCalibration opencv = good(kOpenCv);
  EXPECT_EQ(opencv.fy, 521);
  EXPECT_EQ(opencv.distortion[4], 0.3);
  EXPECT_THAT(refusal(with(kOpenCv, "0.3 ]", "0.3, 0.1, 0, 0 ]")), HasSubstr("rational model"));
  EXPECT_EQ(good(with(kOpenCv, "0.3 ]", "0.3, 0, 0, 0 ]")).distortion[4], 0.3);
  EXPECT_THAT(refusal(with(kOpenCv, "image_width: 640\n", "")), HasSubstr("image_width is missing"));
}

TEST(Calibration, ReadsTheSharedSequencesFiles) {
  const char* shared = std::getenv("GODWIT_SHARED_DIR");
  const std::string data = std::string(shared != nullptr ? shared : "../shared") + "/data/";
  if (!std::filesystem::exists(data)) {
    const char* ci = std::getenv("CI");
    if (ci != nullptr && std::string(ci) == "true") FAIL() << data << " is absent";
    GTEST_SKIP() << data << " is absent: the shared calibration files were not read";
  }
  for (const char* file : {"tum_fr1_xyz/camera.yaml", "euroc_mh01/camera.yaml", "euroc_mh01/cam0_sensor.yaml"}) {
    const auto c = parse_calibration(test::read_file(data + file), file);
    EXPECT_TRUE(c.ok()) << c.error().message;
  }
}

TEST(CalibrationToml, WhatIsWrittenIsReadAgainToTheBit) {
  auto own = parse_calibration(kOwn, "camera.yaml");
  ASSERT_TRUE(own.ok());
  CameraCalibration c = own.value();
  c.readout_frames = 0.6;
  c.T_body_cam = {0, 0, 1, 0.1, 1, 0, 0, -0.02, 0, 1, 0, 0.05, 0, 0, 0, 1};
  c.time_offset_s = -0.0125;
  for (const auto model : {CameraCalibration::Distortion::kRadTan, CameraCalibration::Distortion::kKannalaBrandt4}) {
    c.distortion_model = model;
    if (model == CameraCalibration::Distortion::kKannalaBrandt4) c.distortion[4] = 0;
    for (const bool yaml : {false, true}) {
      const auto read = yaml ? parse_calibration(calibration_yaml(c, "# a word\n"), "sensor.yaml")
                             : parse_calibration(calibration_toml(c, "# a word\n"), "camera.toml");
      ASSERT_TRUE(read.ok()) << read.error().message;
      const CameraCalibration& r = read.value();
      EXPECT_EQ(r.width, c.width);
      EXPECT_EQ(r.height, c.height);
      EXPECT_EQ(r.fx, c.fx);
      EXPECT_EQ(r.fy, c.fy);
      EXPECT_EQ(r.cx, c.cx);
      EXPECT_EQ(r.cy, c.cy);
      EXPECT_EQ(r.distortion_model, c.distortion_model);
      EXPECT_EQ(r.distortion, c.distortion);
      EXPECT_EQ(r.channels, c.channels);
      EXPECT_EQ(r.fps, c.fps);
      EXPECT_NEAR(r.readout_frames, c.readout_frames, 1e-12);
      EXPECT_EQ(r.T_body_cam, c.T_body_cam);
      EXPECT_EQ(r.time_offset_s, c.time_offset_s);
    }
  }
}

TEST(CalibrationToml, MistakesAreNamed) {
  const auto wrong = [](const std::string& text) {
    const auto read = parse_calibration(text, "camera.toml");
    return read.ok() ? std::string() : read.error().message;
  };
  EXPECT_THAT(wrong("x = 1\n"), HasSubstr("camera.toml: no table [camera]"));
  EXPECT_THAT(wrong("[camera]\nmodel = \n"), HasSubstr("camera.toml:2: not TOML"));
  EXPECT_THAT(wrong("[camera]\nmodel = \"pinhole\"\n"), HasSubstr("width"));
}

}  // namespace
}  // namespace godwit::hal::calibration_test
