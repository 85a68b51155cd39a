// `godwit doctor`: camera, inertial sensor and bus of this machine.
#pragma once

#include <memory>
#include <string>

#include "firmware_app/commands/doctor_report.h"
#include "firmware_app/config/config.h"
#include "hal/camera/calibration.h"
#include "hal/camera/camera.h"
#include "hal/sim/flight.h"

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

/// Names the inertial sensors that this machine shows. Flying does not need one, so none is no mistake. root: "/", or
/// what a test puts there.
void examine_imu(const std::string& root, DoctorReport* report);

/// Opens the bus, looks at the interface's settings, and listens for a second whether somebody else has our node id.
void examine_bus(const Config& config, DoctorReport* report);

}  // namespace godwit::app
