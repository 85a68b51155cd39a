// Where a reader of godwitd (live_reader.h) finds it.
#pragma once

#include <optional>
#include <string>

namespace godwit::app {

/// Whose socket it is: the one that is named, that of the configuration, or the service's. Nothing: the configuration
/// has mistakes, which were said.
std::optional<std::string> live_socket(const std::string& named, const std::string& config_file);

}  // namespace godwit::app
