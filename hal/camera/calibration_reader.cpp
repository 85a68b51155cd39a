#include "hal/camera/calibration_reader.h"

#include <cmath>
#include <cstddef>

#include "hal/rt/image.h"

namespace godwit::hal::yaml {

void Reader::fail(const std::string& key, const std::string& reason) const {
  const YAML::Node node = root_[key];
  const std::string where = node && node.Mark().line >= 0 ? ":" + std::to_string(node.Mark().line + 1) : "";
  throw Mistake{name_ + where + ": " + key + ": " + reason};
}

YAML::Node Reader::need(const std::string& key) const {
  if (!has(key)) throw Mistake{name_ + ": " + key + " is missing"};
  return root_[key];
}

std::string Reader::text(const std::string& key) const {
  const YAML::Node node = need(key);
  if (!node.IsScalar()) fail(key, "a text is wanted");
  return node.Scalar();
}

int Reader::to_whole(const std::string& key, double value, int low, int high) const {
  if (value != std::floor(value) || value < low || value > high) {
    fail(key, "a whole number from " + std::to_string(low) + " to " + std::to_string(high) + " is wanted");
  }
  return static_cast<int>(value);
}

std::vector<double> Reader::to_numbers(const std::string& key, const YAML::Node& node) const {
  if (!node.IsSequence()) fail(key, "a list of numbers in [ ] is wanted");
  if (node.size() > 16) fail(key, "a list of at most 16 numbers is wanted");
  std::vector<double> out;
  for (const YAML::Node& item : node) out.push_back(to_number(key, item));
  return out;
}

std::vector<double> Reader::matrix(const std::string& key) const {
  const YAML::Node node = need(key);
  if (node.IsMap()) {
    if (!node["data"]) fail(key, "'data: [numbers]' is wanted");
    return to_numbers(key, node["data"]);
  }
  if (!node.IsSequence() || node.size() == 0 || !node[0].IsSequence()) return to_numbers(key, node);
  if (node.size() > 4) fail(key, "at most 4 rows are wanted");
  std::vector<double> out;
  for (const YAML::Node& row : node) {
    const std::vector<double> values = to_numbers(key, row);
    out.insert(out.end(), values.begin(), values.end());
  }
  return out;
}

double Reader::to_number(const std::string& key, const YAML::Node& node) const {
  double value = 0;
  if (!node.IsScalar() || !YAML::convert<double>::decode(node, value)) fail(key, "a number is wanted");
  if (!std::isfinite(value)) fail(key, "the number is not finite");
  return value;
}

bool starts_with(const std::string& text, std::string_view prefix) {
  return text.compare(0, prefix.size(), prefix) == 0;
}

namespace {

/// Length 4x4, rows orthonormal, last row 0 0 0 1.
bool is_rigid(const std::array<double, 16>& T) {
  for (int a = 0; a < 3; ++a) {
    for (int b = 0; b < 3; ++b) {
      double dot = 0;
      for (int k = 0; k < 3; ++k) dot += T[4 * a + k] * T[4 * b + k];
      if (std::abs(dot - (a == b ? 1.0 : 0.0)) > 1e-3) return false;
    }
  }
  const double det =
      T[0] * (T[5] * T[10] - T[6] * T[9]) - T[1] * (T[4] * T[10] - T[6] * T[8]) + T[2] * (T[4] * T[9] - T[5] * T[8]);
  return det > 0 && T[12] == 0 && T[13] == 0 && T[14] == 0 && T[15] == 1;
}

}  // namespace

void read_pinhole(const Reader& in, CameraCalibration* c) {
  if (in.text("camera_model") != "pinhole") in.fail("camera_model", "'pinhole' is wanted");
  const std::vector<double> size = in.numbers("resolution");
  if (size.size() != 2) in.fail("resolution", "[width, height] is wanted");
  c->width = in.to_whole("resolution", size[0], kMinImageSide, rt::kMaxImageWidth);
  c->height = in.to_whole("resolution", size[1], kMinImageSide, rt::kMaxImageHeight);
  const std::vector<double> k = in.numbers("intrinsics");
  if (k.size() != 4) in.fail("intrinsics", "[fu, fv, cu, cv] is wanted");
  c->fx = k[0];
  c->fy = k[1];
  c->cx = k[2];
  c->cy = k[3];
}

void read_distortion(const Reader& in, const std::string& model_key, const std::string& model,
                     const std::string& coefficients_key, const std::vector<double>& k, CameraCalibration* c) {
  if (starts_with(model, "radtan") || starts_with(model, "radial-tangential") || starts_with(model, "plumb_bob")) {
    c->distortion_model = CameraCalibration::Distortion::kRadTan;
    if (k.size() != 4 && k.size() != 5) in.fail(coefficients_key, "4 (k1 k2 p1 p2) or 5 (and k3) numbers are wanted");
  } else if (starts_with(model, "equi") || starts_with(model, "kannala-brandt") || starts_with(model, "fisheye")) {
    c->distortion_model = CameraCalibration::Distortion::kKannalaBrandt4;
    if (k.size() != 4) in.fail(coefficients_key, "4 numbers (k1 k2 k3 k4) are wanted");
  } else if (starts_with(model, "none")) {
    if (!k.empty()) in.fail(coefficients_key, "must be empty, [], where " + model_key + " is none");
  } else {
    in.fail(model_key, "'" + model.substr(0, 40) +
                           "' is unknown; known are radtan (radial-tangential, plumb_bob), equidistant "
                           "(kannala-brandt) and none");
  }
  for (std::size_t i = 0; i < k.size(); ++i) {
    if (std::abs(k[i]) > 100) in.fail(coefficients_key, "a coefficient beyond 100 is absurd");
    c->distortion[i] = k[i];
  }
}

std::array<double, 16> rigid_motion(const Reader& in, const std::string& key, const std::vector<double>& values) {
  if (values.size() != 16) in.fail(key, "16 numbers (4x4, row by row) are wanted");
  std::array<double, 16> T{};
  for (std::size_t i = 0; i < 16; ++i) T[i] = values[i];
  if (!is_rigid(T)) in.fail(key, "not a rigid motion (rotation and translation)");
  return T;
}

}  // namespace godwit::hal::yaml
