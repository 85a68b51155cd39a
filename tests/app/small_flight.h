// The configuration of a flight that begins at once, for the tests that start the programs.
#pragma once

#include <fstream>
#include <string>

#include "tests/support/temp_folder.h"

namespace godwit::app {

inline const std::string kSmallFlight =
    "[camera]\nsource = \"sim\"\nscenario = \"corridor\"\nscenarios = \"" GODWIT_SCENARIO_DIR "\"\npictures = 2\n";

/// The file that was written, in this folder.
inline std::string write_config(const test::TempFolder& folder, const std::string& text) {
  const std::string file = folder.path() / "godwit.toml";
  std::ofstream(file) << text;
  return file;
}

}  // namespace godwit::app
