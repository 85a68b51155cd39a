// `godwit doctor`: the guided tilt test.
#pragma once

#include <atomic>

#include "firmware_app/commands/doctor_machine.h"
#include "firmware_app/link/link_service.h"

namespace godwit::app {

/// Guides through the tilt test: the camera tracks in the background, the user moves the vehicle and presses Enter.
/// Reads standard input.
void tilt_test(const Config& config, DoctorCamera* camera, link::LinkService* service, DoctorReport* report,
               const std::atomic<bool>& stop);

}  // namespace godwit::app
