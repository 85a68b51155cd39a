#include "hal/camera/calibration_toml.h"

#include <charconv>
#include <toml++/toml.h>

#include "hal/camera/calibration_reader.h"

namespace godwit::hal {
namespace {

std::string number(double x) {
  char text[64];
  return {text, std::to_chars(text, text + sizeof text, x).ptr};
}

template <typename List>
std::string list(const List& values, std::size_t count) {
  std::string out = "[";
  for (std::size_t i = 0; i < count; ++i) out += (i > 0 ? ", " : "") + number(values[i]);
  return out + "]";
}

YAML::Node as_yaml(const toml::node& node) {
  YAML::Node out;
  if (const toml::array* const items = node.as_array()) {
    out = YAML::Node(YAML::NodeType::Sequence);
    for (const toml::node& item : *items) out.push_back(as_yaml(item));
  } else if (const auto* text = node.as_string()) {
    out = text->get();
  } else if (const auto* whole = node.as_integer()) {
    out = whole->get();
  } else if (const auto* real = node.as_floating_point()) {
    out = number(real->get());
  }
  return out;
}

/// A key a line; both languages write text and lists alike.
std::string keys_of(const CameraCalibration& c, const std::string& is) {
  const bool fisheye = c.distortion_model == CameraCalibration::Distortion::kKannalaBrandt4;
  std::string out;
  const auto add = [&](const char* key, const std::string& value) { out += key + is + value + "\n"; };
  add("model", "\"pinhole\"");
  add("width", std::to_string(c.width));
  add("height", std::to_string(c.height));
  for (const auto& [key, value] : {std::pair{"fx", c.fx}, {"fy", c.fy}, {"cx", c.cx}, {"cy", c.cy}}) {
    add(key, number(value));
  }
  add("distortion_model", fisheye ? "\"equidistant\"" : "\"radtan\"");
  add("distortion", list(c.distortion, fisheye || c.distortion[4] == 0 ? 4 : 5));
  add("image_channels", std::to_string(c.channels));
  if (c.fps > 0) add("fps", number(c.fps));
  add("shutter", c.readout_frames > 0 ? "\"rolling\"" : "\"global\"");
  if (c.readout_frames > 0 && c.fps > 0) add("readout_s", number(c.readout_s()));
  if (c.T_body_cam) add("T_body_cam", list(*c.T_body_cam, 16));
  if (c.time_offset_s) add("time_offset_s", number(*c.time_offset_s));
  return out;
}

}  // namespace

namespace yaml {

YAML::Node load_toml(std::string_view text, const std::string& name) {
  try {
    const toml::table root = toml::parse(text, name);
    const toml::table* const camera = root["camera"].as_table();
    if (camera == nullptr) throw Mistake{name + ": no table [camera]"};
    YAML::Node out(YAML::NodeType::Map);
    for (const auto& [key, value] : *camera) out[std::string(key.str())] = as_yaml(value);
    return out;
  } catch (const toml::parse_error& e) {
    throw Mistake{name + ":" + std::to_string(e.source().begin.line) + ": not TOML: " + std::string(e.description())};
  }
}

}  // namespace yaml

std::string calibration_toml(const CameraCalibration& c, const std::string& comment) {
  return comment + "[camera]\n" + keys_of(c, " = ");
}

std::string calibration_yaml(const CameraCalibration& c, const std::string& comment) {
  return comment + keys_of(c, ": ");
}

}  // namespace godwit::hal
