// Whether what was saved over the bus fits what the configuration opens, and what of the configuration it overrides.
#pragma once

#include <string>
#include <vector>

#include "firmware_app/link/parameters.h"
#include "firmware_app/link/storage.h"

namespace godwit::link {

/// What the link has.
struct LinkMeans {
  bool bus = false;
  bool bytes = false;  ///< a MAVLink port
  bool fd = true;      ///< the bus takes CAN FD frames
};

/// Saved values are checked as the configuration's are: one that would contradict it is dropped, with a warning, and
/// the configuration's stands. Allocates.
void drop_what_does_not_fit(const ParameterValues& defaults, const LinkMeans& means, StoredState* state);

/// "VIO_RATE 25, saved over the bus, overrides 30" for each. Allocates.
std::vector<std::string> overrides(const ParameterValues& defaults, const StoredState& state);

}  // namespace godwit::link
