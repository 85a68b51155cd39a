// What may be wrong with the [can] and [link] sections beyond each key's own range.
#pragma once

#include "firmware_app/config/config.h"

namespace godwit::app {

/// Addresses that mean nothing, a mounting that is no rotation, places that are not on Earth, keys that cannot stand
/// together: each a mistake in the report.
void check_link(ConfigReport* report);

}  // namespace godwit::app
