// Where the files lie that come with the programs: networks, scenarios, libraries.
#pragma once

#include <string>

namespace godwit::hal {

/// The folder NAME ("models", "scenarios") of godwit's own files: ../share/godwit/NAME from the folder of the running
/// program, wherever that was installed or moved to; the build folder has the same, by links. Not looked at: what is
/// missing is told by whoever reads it. Reads /proc/self/exe; without /proc from the working directory.
std::string installed_data(const std::string& name);
/// The same of what is loaded when it is wanted: ../lib/godwit/NAME.
std::string installed_library(const std::string& name);

}  // namespace godwit::hal
