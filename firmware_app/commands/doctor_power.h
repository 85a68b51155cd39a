// `godwit doctor`: do the processors keep their clocks, and what tells how warm they are?
#pragma once

#include <string>

#include "firmware_app/commands/doctor_report.h"

namespace godwit::app {

/// Reads the board's power mode (nvpmodel's files), which processors are on, their governors and clocks, and which are
/// isolated; names the thermal zones that count (hal/machine). On a Jetson whatever lets a frame wait for its clock is
/// wrong (docs/jetson.md); elsewhere it is only told. root: "/", or what a test puts there. Blocks on files.
void examine_power(const std::string& root, DoctorReport* report);

}  // namespace godwit::app
