// `godwit doctor`: the network that finds what may move.
#pragma once

#include <string>

#include "firmware_app/commands/doctor_report.h"
#include "firmware_app/config/config.h"
#include "firmware_app/scheduler/scheduler.h"

namespace godwit::app {

/// What it means for a flight that the large network takes large_ns for a picture and the small one small_ns, in a
/// sentence; empty: nothing, it keeps the scheduler's pace. tiled: with detector.tiled. Pure.
std::string pace_advice(rt::TimeNs large_ns, rt::TimeNs small_ns, const SchedulerOptions& scheduler, bool tiled);

/// Loads the networks of the configuration, tells what they are and how long a picture of this size takes on this
/// machine (median of five, after one that is not counted). fps: of the camera; 0 or less: 30. Blocks.
void examine_detector(const Config& config, int picture_width, int picture_height, double fps, DoctorReport* report);

}  // namespace godwit::app
