// `godwit doctor`: the autopilot at the other end, and its parameters.
#pragma once

#include <atomic>
#include <memory>

#include "firmware_app/commands/doctor_machine.h"
#include "firmware_app/link/link_service.h"

namespace godwit::app {

/// Five milliseconds of the link: what came, what is due.
void step_link(link::LinkService* service);

/// Opens the link (which sends no pose), waits for an autopilot, reads the parameters that matter and says which do not
/// fit. heard: who is on the bus. viso_delay_ms: as a flight told it; absent: not compared. Null where nothing could be
/// opened.
std::unique_ptr<link::LinkService> examine_autopilot(const Config& config, const hal::CameraCalibration& calibration,
                                                     const BusHeard& heard, std::optional<int> viso_delay_ms,
                                                     DoctorReport* report, const std::atomic<bool>& stop);

}  // namespace godwit::app
