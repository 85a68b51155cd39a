// What the inertial odometry counts with for a sensor that somebody says something of.
#pragma once

#include "hal/imu/error_model.h"
#include "vo_core/inertial/inertial_odometry.h"
#include "vo_core/inertial/navigation_frame.h"

namespace godwit::app {

/// What nobody says stays that of an MPU-6000 that nobody calibrated (InertialModel, InertialPrior). readout_ns: of the
/// camera's rolling shutter, 0: global.
vo::InertialOdometryOptions inertial_options(const hal::ImuErrorModel& errors, rt::TimeNs readout_ns = 0);
/// The same for dead reckoning. coast_ns: how long a place without a picture is told at most.
vo::NavigationOptions navigation_options(const hal::ImuErrorModel& errors, rt::TimeNs coast_ns);

}  // namespace godwit::app
