// What was saved over the bus, as text; whether it fits what the configuration opens, and what of the configuration it
// overrides.
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

/// The file's text into *state, whose parameters are the configuration's: "NAME value" in each line; '#' begins a
/// comment. Unknown names are passed over: they belong to another version. What is wrong is left out, with a warning
/// that names file and line. Allocates.
void read_saved_parameters(const std::string& path, const std::string& text, StoredState* state);
/// What the file is to say: what differs from the configuration. Allocates.
std::string saved_parameters_text(const ParameterValues& parameters, const ParameterValues& defaults);

/// Saved values are checked as the configuration's are: one that would contradict it is dropped, with a warning, and
/// the configuration's stands. Allocates.
void drop_what_does_not_fit(const ParameterValues& defaults, const LinkMeans& means, StoredState* state);

/// "VIO_RATE 25, saved over the bus, overrides 30" for each. Allocates.
std::vector<std::string> overrides(const ParameterValues& defaults, const StoredState& state);

}  // namespace godwit::link
