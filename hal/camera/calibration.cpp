#include "hal/camera/calibration.h"

#include <cmath>
#include <vector>
#include <yaml-cpp/yaml.h>

#include "hal/rt/image.h"

namespace godwit::hal {
namespace {

constexpr int kMinImageSide = 64;  ///< below it no pyramid level above 0 holds a patch

/// A mistake in the file, thrown to the wall in parse_calibration (yaml-cpp throws there as well).
struct Mistake {
  std::string message;
};

class Reader {
 public:
  Reader(const YAML::Node& root, std::string name) : root_(root), name_(std::move(name)) {}

  [[noreturn]] void fail(const std::string& key, const std::string& reason) const {
    const YAML::Node node = root_[key];
    const std::string where = node && node.Mark().line >= 0 ? ":" + std::to_string(node.Mark().line + 1) : "";
    throw Mistake{name_ + where + ": " + key + ": " + reason};
  }
  bool has(const std::string& key) const { return static_cast<bool>(root_[key]); }
  YAML::Node need(const std::string& key) const {
    if (!has(key)) throw Mistake{name_ + ": " + key + " is missing"};
    return root_[key];
  }
  std::string text(const std::string& key) const {
    const YAML::Node node = need(key);
    if (!node.IsScalar()) fail(key, "a text is wanted");
    return node.Scalar();
  }
  double number(const std::string& key) const { return to_number(key, need(key)); }
  int whole(const std::string& key, int low, int high) const { return to_whole(key, number(key), low, high); }
  int to_whole(const std::string& key, double value, int low, int high) const {
    if (value != std::floor(value) || value < low || value > high) {
      fail(key, "a whole number from " + std::to_string(low) + " to " + std::to_string(high) + " is wanted");
    }
    return static_cast<int>(value);
  }
  std::vector<double> numbers(const std::string& key) const { return to_numbers(key, need(key)); }
  std::vector<double> to_numbers(const std::string& key, const YAML::Node& node) const {
    if (!node.IsSequence()) fail(key, "a list of numbers in [ ] is wanted");
    if (node.size() > 16) fail(key, "a list of at most 16 numbers is wanted");
    std::vector<double> out;
    for (const YAML::Node& item : node) out.push_back(to_number(key, item));
    return out;
  }

 private:
  double to_number(const std::string& key, const YAML::Node& node) const {
    double value = 0;
    if (!node.IsScalar() || !YAML::convert<double>::decode(node, value)) fail(key, "a number is wanted");
    if (!std::isfinite(value)) fail(key, "the number is not finite");
    return value;
  }

  YAML::Node root_;
  std::string name_;
};

bool starts_with(const std::string& text, std::string_view prefix) {
  return text.compare(0, prefix.size(), prefix) == 0;
}

/// Length 4x4, rows orthonormal, last row 0 0 0 1.
bool is_rigid(const std::array<double, 16>& T) {
  for (int a = 0; a < 3; ++a) {
    for (int b = 0; b < 3; ++b) {
      double dot = 0;
      for (int k = 0; k < 3; ++k)
        dot += T[static_cast<std::size_t>(4 * a + k)] * T[static_cast<std::size_t>(4 * b + k)];
      if (std::abs(dot - (a == b ? 1.0 : 0.0)) > 1e-3) return false;
    }
  }
  const double det =
      T[0] * (T[5] * T[10] - T[6] * T[9]) - T[1] * (T[4] * T[10] - T[6] * T[8]) + T[2] * (T[4] * T[9] - T[5] * T[8]);
  return det > 0 && T[12] == 0 && T[13] == 0 && T[14] == 0 && T[15] == 1;
}

void read_distortion(const Reader& in, const std::string& coefficients_key, CameraCalibration* c) {
  const std::string model = in.text("distortion_model");
  const std::vector<double> k = in.numbers(coefficients_key);
  if (starts_with(model, "radtan") || starts_with(model, "radial-tangential") || starts_with(model, "plumb_bob")) {
    c->distortion_model = CameraCalibration::Distortion::kRadTan;
    if (k.size() != 4 && k.size() != 5) in.fail(coefficients_key, "4 (k1 k2 p1 p2) or 5 (and k3) numbers are wanted");
  } else if (starts_with(model, "equidistant") || starts_with(model, "kannala-brandt")) {
    c->distortion_model = CameraCalibration::Distortion::kKannalaBrandt4;
    if (k.size() != 4) in.fail(coefficients_key, "4 numbers (k1 k2 k3 k4) are wanted");
  } else if (starts_with(model, "none")) {
    if (!k.empty()) in.fail(coefficients_key, "must be empty, [], where distortion_model is none");
  } else {
    in.fail("distortion_model", "'" + model.substr(0, 40) +
                                    "' is unknown; known are radtan (radial-tangential, plumb_bob), equidistant "
                                    "(kannala-brandt) and none");
  }
  for (std::size_t i = 0; i < k.size(); ++i) {
    if (std::abs(k[i]) > 100) in.fail(coefficients_key, "a coefficient beyond 100 is absurd");
    c->distortion[i] = k[i];
  }
}

void read_pose(const Reader& in, const std::string& key, const std::vector<double>& values, CameraCalibration* c) {
  if (values.size() != 16) in.fail(key, "16 numbers (4x4, row by row) are wanted");
  std::array<double, 16> T{};
  for (std::size_t i = 0; i < 16; ++i) T[i] = values[i];
  if (!is_rigid(T)) in.fail(key, "not a rigid motion (rotation and translation)");
  c->T_body_cam = T;
}

void check_intrinsics(const std::string& name, const CameraCalibration& c) {
  const auto fail = [&](const std::string& key, const std::string& reason) {
    throw Mistake{name + ": " + key + ": " + reason};
  };
  // A field of view of 2 to 174 degrees across.
  const double longest = 30.0 * c.width, shortest = 0.05 * c.width;
  if (!(c.fx >= shortest && c.fx <= longest)) fail("fx", "absurd for a picture " + std::to_string(c.width) + " wide");
  if (!(c.fy >= shortest && c.fy <= longest)) fail("fy", "absurd for a picture " + std::to_string(c.width) + " wide");
  if (c.fx > 3 * c.fy || c.fy > 3 * c.fx) fail("fy", "differs from fx by more than a factor of 3");
  if (!(c.cx > 0 && c.cx < c.width - 1)) fail("cx", "the centre lies outside the picture");
  if (!(c.cy > 0 && c.cy < c.height - 1)) fail("cy", "the centre lies outside the picture");
}

/// Keys shutter ("global", "rolling (..)") and readout_s. After fps.
void read_shutter(const Reader& in, CameraCalibration* c) {
  if (in.has("shutter")) {
    const std::string shutter = in.text("shutter");
    if (starts_with(shutter, "rolling")) {
      c->readout_frames = kTypicalReadout;
    } else if (!starts_with(shutter, "global")) {
      in.fail("shutter", "'" + shutter.substr(0, 40) + "' is unknown; known are global and rolling");
    }
  }
  if (!in.has("readout_s")) return;
  const double readout_s = in.number("readout_s");
  if (!(c->fps > 0)) in.fail("readout_s", "needs fps");
  c->readout_frames = readout_s * c->fps;
  if (!(c->readout_frames >= 0 && c->readout_frames <= 1)) in.fail("readout_s", "must lie between 0 and 1 / fps");
}

CameraCalibration read_own(const Reader& in) {
  CameraCalibration c;
  if (in.text("model") != "pinhole")
    in.fail("model", "'pinhole' is wanted (fisheye: with distortion_model equidistant)");
  c.width = in.whole("width", kMinImageSide, rt::kMaxImageWidth);
  c.height = in.whole("height", kMinImageSide, rt::kMaxImageHeight);
  c.fx = in.number("fx");
  c.fy = in.number("fy");
  c.cx = in.number("cx");
  c.cy = in.number("cy");
  read_distortion(in, "distortion", &c);
  if (in.has("fps")) c.fps = in.number("fps");
  read_shutter(in, &c);
  if (in.has("image_channels")) {
    // "3", or "1 (grey 8 bit)".
    const std::string channels = in.text("image_channels");
    if (channels != "1" && channels != "3" && !starts_with(channels, "1 ") && !starts_with(channels, "3 ")) {
      in.fail("image_channels", "1 (grey) or 3 (colour) is wanted");
    }
    c.channels = channels[0] - '0';
  }
  if (in.has("T_body_cam")) read_pose(in, "T_body_cam", in.numbers("T_body_cam"), &c);
  return c;
}

CameraCalibration read_euroc(const Reader& in) {
  CameraCalibration c;
  if (in.text("camera_model") != "pinhole") in.fail("camera_model", "'pinhole' is wanted");
  const std::vector<double> size = in.numbers("resolution");
  if (size.size() != 2) in.fail("resolution", "[width, height] is wanted");
  c.width = in.to_whole("resolution", size[0], kMinImageSide, rt::kMaxImageWidth);
  c.height = in.to_whole("resolution", size[1], kMinImageSide, rt::kMaxImageHeight);
  const std::vector<double> k = in.numbers("intrinsics");
  if (k.size() != 4) in.fail("intrinsics", "[fu, fv, cu, cv] is wanted");
  c.fx = k[0];
  c.fy = k[1];
  c.cx = k[2];
  c.cy = k[3];
  read_distortion(in, "distortion_coefficients", &c);
  if (in.has("rate_hz")) c.fps = in.number("rate_hz");
  if (in.has("T_BS")) {
    const YAML::Node pose = in.need("T_BS");
    if (!pose.IsMap() || !pose["data"]) in.fail("T_BS", "'data: [16 numbers]' is wanted");
    read_pose(in, "T_BS", in.to_numbers("T_BS", pose["data"]), &c);
  }
  return c;
}

}  // namespace

rt::Result<CameraCalibration> parse_calibration(std::string_view text, const std::string& name) {
  try {
    const YAML::Node root = YAML::Load(std::string(text));
    if (!root.IsMap()) return rt::Error{name + ": not a list of 'key: value' lines"};
    const Reader in(root, name);
    if (!in.has("model") && !in.has("camera_model")) {
      return rt::Error{name + ": neither 'model' (camera.yaml) nor 'camera_model' (EuRoC's sensor.yaml) is given"};
    }
    const CameraCalibration c = in.has("model") ? read_own(in) : read_euroc(in);
    if (c.fps < 0 || c.fps > 1000) return rt::Error{name + ": frame rate: from 0 to 1000 is wanted"};
    check_intrinsics(name, c);
    return c;
  } catch (const Mistake& mistake) {
    return rt::Error{mistake.message};
  } catch (const YAML::Exception& e) {
    return rt::Error{name + ":" + std::to_string(e.mark.line + 1) + ": not YAML: " + e.msg};
  }
}

}  // namespace godwit::hal
