// What godwitd does: a configuration in, a flight until it is told to stop.
#pragma once

#include <atomic>

#include "firmware_app/config/config.h"

namespace godwit::app {

/// Flies until *stop becomes true (then kExitDone: that is how a daemon ends) or the camera is at its end. Tells state
/// changes, degradation and at the end the counts on the error stream, a line each, for the journal. Precondition: the
/// configuration has passed check_for_daemon. Returns an ExitCode.
int run_daemon(const Config& config, const std::atomic<bool>& stop);

}  // namespace godwit::app
