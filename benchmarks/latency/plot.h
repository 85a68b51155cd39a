// The ages as a picture: histogram beside timeline.
#pragma once

#include <string>

#include "benchmarks/latency/report.h"
#include "hal/rt/result.h"

namespace godwit::bench {

/// Draws a row for each flight: how often which age at pose, and the age over the flight, with delivery and deadline as
/// lines, as a PNG. Error: the file cannot be written.
rt::Result<void> plot(const Run& run, const std::string& file);

}  // namespace godwit::bench
