// What a simulated flight's rangefinder, barometer, satellites and autopilot would have left on file.
#pragma once

#include <vector>

#include "hal/aid/replay/aid_record.h"
#include "hal/sim/flight/flight.h"

namespace godwit::app {

/// Those of the kinds wanted that the scenario has, in times that count from the flight's start as its camera's do.
hal::AidRecord aid_record_of(const sim::Flight& flight, const std::vector<hal::AidKind>& kinds);

}  // namespace godwit::app
