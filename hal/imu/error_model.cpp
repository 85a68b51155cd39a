#include "hal/imu/error_model.h"

#include <cmath>
#include <yaml-cpp/yaml.h>

#include "hal/record_file.h"

namespace godwit::hal {
namespace {

/// What is allowed reaches from the best sensors that fly to ones that nobody would: a unit gone wrong is beyond it.
struct Key {
  const char* name;
  std::optional<double> ImuErrorModel::*value;
  double least, most;
  const char* unit;
};
constexpr Key kKeys[] = {
    {"gyroscope_noise_density", &ImuErrorModel::gyroscope_noise_density, 1e-7, 0.1, "rad/s/sqrt(Hz)"},
    {"gyroscope_random_walk", &ImuErrorModel::gyroscope_random_walk, 0, 0.1, "rad/s^2/sqrt(Hz)"},
    {"accelerometer_noise_density", &ImuErrorModel::accelerometer_noise_density, 1e-6, 1, "m/s^2/sqrt(Hz)"},
    {"accelerometer_random_walk", &ImuErrorModel::accelerometer_random_walk, 0, 1, "m/s^3/sqrt(Hz)"},
    {"accelerometer_bias_sigma", &ImuErrorModel::accelerometer_bias_sigma, 1e-4, 5, "m/s^2"},
    {"accelerometer_scale_sigma", &ImuErrorModel::accelerometer_scale_sigma, 0, 0.2, "of what is measured"},
    {"gyroscope_range", &ImuErrorModel::gyroscope_range, 0.5, 100, "rad/s"},
    {"accelerometer_range", &ImuErrorModel::accelerometer_range, 10, 1000, "m/s^2"},
};

}  // namespace

bool ImuErrorModel::empty() const {
  for (const Key& key : kKeys) {
    if (this->*key.value) return false;
  }
  return true;
}

rt::Result<ImuErrorModel> parse_imu_error_model(std::string_view text, const std::string& name) {
  ImuErrorModel out;
  try {
    const YAML::Node root = YAML::Load(std::string(text));
    if (!root.IsMap()) return rt::Error{name + ": not a list of 'key: value' lines"};
    for (const Key& key : kKeys) {
      const YAML::Node node = root[key.name];
      if (!node) continue;
      double value = 0;
      if (!node.IsScalar() || !YAML::convert<double>::decode(node, value) || !std::isfinite(value) ||
          value < key.least || value > key.most) {
        char range[80];
        std::snprintf(range, sizeof range, "a number from %g to %g [%s] is wanted", key.least, key.most, key.unit);
        return rt::Error{name + ":" + std::to_string(node.Mark().line + 1) + ": " + key.name + ": " + range};
      }
      out.*key.value = value;
    }
  } catch (const YAML::Exception& e) {
    return rt::Error{name + ":" + std::to_string(e.mark.line + 1) + ": not YAML: " + e.msg};
  }
  return out;
}

std::string sensor_yaml(double rate_hz, const ImuRanges& ranges) {
  ImuErrorModel known;
  known.gyroscope_range = ranges.gyro_rad_s;
  known.accelerometer_range = ranges.accel_m_s2;
  std::string keys;
  for (const Key& key : kKeys) {
    const auto& value = known.*key.value;
    if (!value || !(*value >= key.least && *value <= key.most)) continue;
    char line[80];
    std::snprintf(line, sizeof line, "%s: %.9g  # [%s]\n", key.name, *value, key.unit);
    keys += line;
  }
  if (keys.empty()) return {};
  char head[80];
  std::snprintf(head, sizeof head, "sensor_type: imu\nrate_hz: %.9g\n", rate_hz);
  return head + keys;
}

rt::Result<ImuErrorModel> read_imu_error_model(const std::string& file) {
  const auto text = read_text_file(file);
  if (!text) return text.error();
  auto out = parse_imu_error_model(text.value(), file);
  if (out && out.value().empty())
    return rt::Error{file + ": none of " + kKeys[0].name + ", " + kKeys[2].name + ", .. is there (Kalibr's imu.yaml)"};
  return out;
}

}  // namespace godwit::hal
