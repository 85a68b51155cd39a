// Which network files a configuration means, and whether they can be what is meant.
#pragma once

#include <functional>
#include <string>

#include "firmware_app/config/config.h"

namespace godwit::app {

struct ModelFiles {
  std::string large;
  std::string small;  ///< for the smaller input of the ladder; empty: the large one
};

/// With the files that come with godwit where the configuration names none.
ModelFiles model_files(const Config::Detector& config);

/// How the configuration wants them run.
detector::DetectorOptions detector_options(const Config::Detector& config);

/// Looks at files and metadata without loading a network: missing or unreadable files, wrong metadata, two networks
/// that do not go together. Calls wrong(key, reason) for each mistake. Reads files.
void check_model_files(const Config::Detector& config,
                       const std::function<void(const std::string&, const std::string&)>& wrong);

}  // namespace godwit::app
