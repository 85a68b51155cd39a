// A flight log read back, as far as a flight is flown again by it.
#pragma once

#include <cstdint>
#include <string>

#include "firmware_app/pipeline/as_flown.h"
#include "hal/rt/result.h"

namespace godwit::app {

/// Reads the flight that begins with this file (NNNNNN.ulg), and goes on with the files after it in the folder while
/// they hold its next frames. A frame that is missing, a detection that is missing, an end that is missing or a message
/// that makes no sense: FlownLog::gap says so, and the frames before it are there. Error: the file cannot be read, is
/// no flight log, or holds no frame to begin with.
rt::Result<FlownLog> read_flown_log(const std::string& file);

/// Leaves of a log what belongs to the first `pictures`; a gap that lies behind them is none any more.
void keep_first(std::int64_t pictures, FlownLog* log);

}  // namespace godwit::app
