// Reading calibrations out of YAML: what every format has in common. Internal to the readers.
#pragma once

#include <array>
#include <string>
#include <string_view>
#include <vector>
#include <yaml-cpp/yaml.h>

#include "hal/camera/calibration.h"

namespace godwit::hal::yaml {

constexpr int kMinImageSide = 64;  ///< below it no pyramid level above 0 holds a patch

/// A mistake in the file, thrown to the wall in parse_calibration (yaml-cpp throws there as well).
struct Mistake {
  std::string message;
};

/// One map of the file. Whatever is wrong is thrown, with the file's name, line and key.
class Reader {
 public:
  Reader(const YAML::Node& root, std::string name) : root_(root), name_(std::move(name)) {}

  [[noreturn]] void fail(const std::string& key, const std::string& reason) const;
  bool has(const std::string& key) const { return static_cast<bool>(root_[key]); }
  YAML::Node need(const std::string& key) const;
  std::string text(const std::string& key) const;
  double number(const std::string& key) const { return to_number(key, need(key)); }
  int whole(const std::string& key, int low, int high) const { return to_whole(key, number(key), low, high); }
  int to_whole(const std::string& key, double value, int low, int high) const;
  std::vector<double> numbers(const std::string& key) const { return to_numbers(key, need(key)); }
  std::vector<double> to_numbers(const std::string& key, const YAML::Node& node) const;
  /// A matrix row by row: OpenCV's and ROS's {rows, cols, data: [..]}, Kalibr's [[..], ..] or a plain list.
  std::vector<double> matrix(const std::string& key) const;

 private:
  double to_number(const std::string& key, const YAML::Node& node) const;

  YAML::Node root_;
  std::string name_;
};

bool starts_with(const std::string& text, std::string_view prefix);
/// What Kalibr and EuRoC call camera_model (pinhole alone), resolution and intrinsics.
void read_pinhole(const Reader& in, CameraCalibration* c);
/// model: as the file calls it.
void read_distortion(const Reader& in, const std::string& model_key, const std::string& model,
                     const std::string& coefficients_key, const std::vector<double>& coefficients,
                     CameraCalibration* c);
/// 16 numbers that must be a rigid motion.
std::array<double, 16> rigid_motion(const Reader& in, const std::string& key, const std::vector<double>& values);

/// Table [camera] of our own TOML as the map that camera.yaml is.
YAML::Node load_toml(std::string_view text, const std::string& name);
/// Kalibr's camchain.yaml and camchain-imucam.yaml: its first camera, cam0 (T_cam_imu is turned into T_body_cam).
CameraCalibration read_kalibr(const YAML::Node& root, const std::string& name);
/// ROS's camera_info, as camera_calibration writes it.
CameraCalibration read_ros(const Reader& in);
/// OpenCV's FileStorage, with the keys of its calibration sample and their usual variants.
CameraCalibration read_opencv(const Reader& in);

}  // namespace godwit::hal::yaml
