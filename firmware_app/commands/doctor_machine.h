// `godwit doctor`: camera, inertial sensor and bus of this machine.
#pragma once

#include <memory>
#include <set>
#include <string>

#include "firmware_app/commands/doctor_report.h"
#include "firmware_app/config/config.h"
#include "hal/camera/calibration.h"
#include "hal/camera/camera.h"
#include "hal/sim/flight/flight.h"

namespace godwit::app {

/// A camera that opened, with its calibration.
struct DoctorCamera {
  std::unique_ptr<sim::Flight> flight;  ///< outlives the camera
  std::unique_ptr<hal::Camera> camera;  ///< null: none could be opened
  hal::CameraCalibration calibration;
};

/// Opens the camera of the configuration, or a recorded sequence in its place, takes pictures for two seconds at most
/// and compares size and rate with the calibration. Blocks.
DoctorCamera examine_camera(const Config& config, const std::string& sequence, DoctorReport* report);

/// Who was heard on the bus.
struct BusHeard {
  int frames = 0;
  std::set<int> nodes;    ///< that told their NodeStatus
  std::set<int> tunnels;  ///< that sent something through a tunnel
};

/// Opens the bus, looks at the interface's settings, and listens for a second who is there, and whether somebody else
/// has our node id.
BusHeard examine_bus(const Config& config, DoctorReport* report);

/// "11 (speaks through a tunnel), 25", or "none".
std::string node_words(const BusHeard& heard);

}  // namespace godwit::app
