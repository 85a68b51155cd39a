// `godwit doctor`: what systemd will refuse the service on this machine.
#pragma once

#include <string>

#include "firmware_app/commands/doctor_report.h"
#include "firmware_app/config/config.h"

namespace godwit::app {

/// Whether godwitd.service, as installed, will get what this configuration asks for: locked memory, priorities, a
/// kernel that lets a service have them (RT_GROUP_SCHED), and its devices (class in DeviceAllow=, rights of its user).
/// Starts nothing and changes nothing. root: "/", or what a test puts there.
void examine_service(const std::string& root, const Config& config, DoctorReport* report);

}  // namespace godwit::app
