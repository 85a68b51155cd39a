#include "hal/camera/calibration.h"

#include <algorithm>
#include <cmath>
#include <vector>
#include <yaml-cpp/yaml.h>

#include "hal/camera/calibration_reader.h"
#include "hal/rt/image.h"

namespace godwit::hal {
namespace {

using yaml::kMinImageSide;
using yaml::Mistake;
using yaml::Reader;
using yaml::starts_with;

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
  yaml::read_distortion(in, "distortion_model", in.text("distortion_model"), "distortion", in.numbers("distortion"),
                        &c);
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
  if (in.has("T_body_cam")) c.T_body_cam = yaml::rigid_motion(in, "T_body_cam", in.numbers("T_body_cam"));
  if (in.has("time_offset_s")) {
    c.time_offset_s = in.number("time_offset_s");
    if (std::abs(*c.time_offset_s) > 1) in.fail("time_offset_s", "at most a second is wanted");
  }
  return c;
}

CameraCalibration read_euroc(const Reader& in) {
  CameraCalibration c;
  yaml::read_pinhole(in, &c);
  yaml::read_distortion(in, "distortion_model", in.text("distortion_model"), "distortion_coefficients",
                        in.numbers("distortion_coefficients"), &c);
  if (in.has("rate_hz")) c.fps = in.number("rate_hz");
  if (in.has("T_BS")) {
    const YAML::Node pose = in.need("T_BS");
    if (!pose.IsMap() || !pose["data"]) in.fail("T_BS", "'data: [16 numbers]' is wanted");
    c.T_body_cam = yaml::rigid_motion(in, "T_BS", in.to_numbers("T_BS", pose["data"]));
  }
  return c;
}

}  // namespace

rt::Result<CameraCalibration> parse_calibration(std::string_view text, const std::string& name) {
  // OpenCV begins its files with "%YAML:1.0", which is no YAML.
  if (text.compare(0, 6, "%YAML:") == 0) text.remove_prefix(std::min(text.find('\n'), text.size()));
  try {
    const bool toml = name.size() > 5 && name.compare(name.size() - 5, 5, ".toml") == 0;
    const YAML::Node root = toml ? yaml::load_toml(text, name) : YAML::Load(std::string(text));
    if (!root.IsMap()) return rt::Error{name + ": not a list of 'key: value' lines"};
    const Reader in(root, name);
    CameraCalibration c;
    if (in.has("model")) {
      c = read_own(in);
    } else if (in.has("cam0")) {
      c = yaml::read_kalibr(root, name);
    } else if (in.has("camera_matrix") && in.has("distortion_model")) {
      c = yaml::read_ros(in);
    } else if (in.has("camera_model")) {
      c = read_euroc(in);
    } else if (in.has("camera_matrix") || in.has("cameraMatrix") || in.has("Camera_Matrix") || in.has("K")) {
      c = yaml::read_opencv(in);
    } else {
      return rt::Error{name +
                       ": neither 'model' (camera.yaml), 'camera_model' (EuRoC's sensor.yaml), 'cam0' (Kalibr) nor "
                       "'camera_matrix' (ROS, OpenCV) is given"};
    }
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
