// How a command ends that cannot go on.
#pragma once

#include <fmt/format.h>
#include <string>

#include "firmware_app/program/exit_code.h"

namespace godwit::app {

/// Tells the message on the error stream, and gives the exit code back.
inline int stopped(const std::string& message, ExitCode code) {
  fmt::print(stderr, "godwit: {}\n", message);
  return code;
}

}  // namespace godwit::app
