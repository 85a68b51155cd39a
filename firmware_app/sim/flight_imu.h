// The readings that a simulated flight's inertial sensor would have left on file.
#pragma once

#include "hal/imu/replay/imu_record.h"
#include "hal/sim/flight/flight.h"

namespace godwit::app {

/// What its data sheet would say; a scenario's faults are not in it.
hal::ImuErrorModel imu_errors_of(const sim::Scenario& scenario);

/// All that it measures, in times that count from the flight's start as its camera's do.
hal::ImuRecord imu_record_of(const sim::Flight& flight);

}  // namespace godwit::app
