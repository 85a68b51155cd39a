// Calibrations as other programs write them.
#include <array>
#include <cstddef>

#include "hal/camera/calibration_reader.h"
#include "hal/rt/image.h"

namespace godwit::hal::yaml {
namespace {

std::array<double, 16> inverse(const std::array<double, 16>& T) {
  std::array<double, 16> out{};
  for (std::size_t r = 0; r < 3; ++r) {
    for (std::size_t c = 0; c < 3; ++c) {
      out[4 * r + c] = T[4 * c + r];
      out[4 * r + 3] -= T[4 * c + r] * T[4 * c + 3];
    }
  }
  out[15] = 1;
  return out;
}

/// fx 0 cx, 0 fy cy, 0 0 1.
void read_camera_matrix(const Reader& in, const std::string& key, CameraCalibration* c) {
  const std::vector<double> k = in.matrix(key);
  if (k.size() != 9) in.fail(key, "9 numbers (3x3, row by row) are wanted");
  if (k[1] != 0 || k[3] != 0 || k[6] != 0 || k[7] != 0 || k[8] != 1) {
    in.fail(key, "fx 0 cx, 0 fy cy, 0 0 1 is wanted; skew is not supported");
  }
  c->fx = k[0];
  c->fy = k[4];
  c->cx = k[2];
  c->cy = k[5];
}

/// OpenCV's models share one list; what is longer than five is another model unless it is zero.
std::vector<double> five_at_most(const Reader& in, const std::string& key) {
  std::vector<double> k = in.matrix(key);
  for (std::size_t i = 5; i < k.size(); ++i) {
    if (k[i] != 0)
      in.fail(key, "the rational model (more than five coefficients) is not supported; calibrate with five");
  }
  if (k.size() > 5) k.resize(5);
  return k;
}

}  // namespace

CameraCalibration read_kalibr(const YAML::Node& root, const std::string& name) {
  if (!root["cam0"].IsMap()) throw Mistake{name + ": cam0: a map of keys is wanted"};
  const Reader in(root["cam0"], name);
  CameraCalibration c;
  read_pinhole(in, &c);
  read_distortion(in, "distortion_model", in.text("distortion_model"), "distortion_coeffs",
                  in.numbers("distortion_coeffs"), &c);
  if (in.has("T_cam_imu")) c.T_body_cam = inverse(rigid_motion(in, "T_cam_imu", in.matrix("T_cam_imu")));
  if (in.has("timeshift_cam_imu")) {
    c.time_offset_s = in.number("timeshift_cam_imu");
    if (!(*c.time_offset_s > -1 && *c.time_offset_s < 1)) in.fail("timeshift_cam_imu", "must lie between -1 and 1 s");
  }
  return c;
}

CameraCalibration read_ros(const Reader& in) {
  CameraCalibration c;
  c.width = in.whole("image_width", kMinImageSide, rt::kMaxImageWidth);
  c.height = in.whole("image_height", kMinImageSide, rt::kMaxImageHeight);
  read_camera_matrix(in, "camera_matrix", &c);
  read_distortion(in, "distortion_model", in.text("distortion_model"), "distortion_coefficients",
                  five_at_most(in, "distortion_coefficients"), &c);
  return c;
}

CameraCalibration read_opencv(const Reader& in) {
  CameraCalibration c;
  const auto first_of = [&](std::initializer_list<const char*> keys) -> std::string {
    for (const char* key : keys) {
      if (in.has(key)) return key;
    }
    return *keys.begin();  // whoever needs it says that it is missing
  };
  c.width = in.whole(first_of({"image_width", "image_Width", "width"}), kMinImageSide, rt::kMaxImageWidth);
  c.height = in.whole(first_of({"image_height", "image_Height", "height"}), kMinImageSide, rt::kMaxImageHeight);
  read_camera_matrix(in, first_of({"camera_matrix", "cameraMatrix", "Camera_Matrix", "K"}), &c);
  const std::string key =
      first_of({"distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "dist_coeffs", "D"});
  // OpenCV's sample says fisheye_model: 1 for the equidistant one.
  const bool fisheye = in.has("fisheye_model") && in.number("fisheye_model") != 0;
  read_distortion(in, key, fisheye ? "equidistant" : "radtan", key, five_at_most(in, key), &c);
  return c;
}

}  // namespace godwit::hal::yaml
