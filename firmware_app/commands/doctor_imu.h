// What `godwit doctor` says of the inertial sensor.
#pragma once

#include <string>

#include "firmware_app/commands/doctor_report.h"
#include "firmware_app/config/config.h"
#include "hal/imu/imu.h"

namespace godwit::app {

/// Opens the sensor of the configuration and judges it; where none is configured, names those that this machine shows:
/// flying does not need one, so none is no mistake. root: "/", or what a test puts there. Blocks for two seconds.
void examine_imu(const Config& config, const std::string& root, DoctorReport* report);

/// Takes readings for a second and a half and judges their rate and, as the machine is taken to stand still, gravity.
void judge_imu(const std::string& name, double rate_hz, hal::Imu* imu, DoctorReport* report);

}  // namespace godwit::app
