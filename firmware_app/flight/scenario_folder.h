// In which folder names of scenarios are looked up.
#pragma once

#include <string>

#include "hal/machine/installed_data.h"

namespace godwit::app {

/// The folder that was asked for; empty: the one that comes with godwit.
inline std::string scenario_folder(const std::string& wanted) {
  return wanted.empty() ? hal::installed_data("scenarios") : wanted;
}

}  // namespace godwit::app
