// The inertial sensor that godwitd's configuration names: a device, or what was recorded beside its camera's pictures.
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "firmware_app/config/config.h"
#include "firmware_app/daemon/daemon_camera.h"
#include "hal/imu/error_model.h"
#include "hal/imu/imu.h"

namespace godwit::app {

/// The sensor is that of the recording or scenario: the camera must go forth only.
bool imu_goes_with_camera(const Config& config);

/// How the sensor of the recording or scenario errs, where they say it; nothing of devices. Error: what says it cannot
/// be read. Blocks.
rt::Result<hal::ImuErrorModel> daemon_imu_errors(const Config& config, const DaemonCamera& camera);

/// Null where none is configured. camera: opened; outlives it. Error: a recording without a sensor, or what is wrong
/// with a key. Blocks.
rt::Result<std::unique_ptr<hal::Imu>> open_daemon_imu(const Config& config, const DaemonCamera& camera,
                                                      const std::function<void(const std::string&)>& say);

}  // namespace godwit::app
