// The ages as a picture: histogram beside timeline.
#pragma once

#include <string>

#include "benchmarks/latency/report.h"
#include "hal/rt/result.h"

namespace godwit::bench {

/// Draws a row for each flight: how often which age at pose, and the age over the flight, with delivery and deadline as
/// lines. The bytes of a PNG; error: libpng's.
rt::Result<std::string> plot(const Run& run);

}  // namespace godwit::bench
