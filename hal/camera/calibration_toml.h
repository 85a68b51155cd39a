// Our own calibration file as TOML: what `godwit calibrate camera` writes and parse_calibration reads.
#pragma once

#include <string>

#include "hal/camera/calibration.h"

namespace godwit::hal {

/// Table [camera] with the keys of camera.yaml. comment: lines that begin with "# ", put first; may be empty.
std::string calibration_toml(const CameraCalibration& c, const std::string& comment);

/// The same keys as YAML, without a table: what parse_calibration reads as camera.yaml or sensor.yaml.
std::string calibration_yaml(const CameraCalibration& c, const std::string& comment);

}  // namespace godwit::hal
