// What only this machine can say of a configuration: files that must be there, processors, sizes.
#pragma once

#include "firmware_app/config/config.h"

namespace godwit::app {

/// Adds to *report what is wrong here with a configuration that is right in itself: missing files, processors that this
/// machine does not have, too few frame slots. Reads files.
void check_on_this_machine(ConfigReport* report);

/// The same, and what a daemon needs beyond it: a camera.
void check_for_daemon(ConfigReport* report);

}  // namespace godwit::app
