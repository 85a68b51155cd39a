// The calibration that a simulated flight's camera would have on file.
#pragma once

#include "hal/camera/calibration.h"
#include "hal/sim/flight/flight.h"

namespace godwit::app {

hal::CameraCalibration calibration_of(const sim::Flight& flight);

}  // namespace godwit::app
