// The command line of godwit-latency.
#pragma once

#include <string>
#include <vector>

#include "benchmarks/latency/figures.h"

namespace godwit::bench {

struct Options {
  std::string input;        ///< folder of a sequence, or a scenario's name or file
  std::string config_file;  ///< empty: the defaults
  bool live = false;        ///< the camera that config_file names takes the place of input
  std::string detector = "both";
  double seconds = 20;  ///< of flight, each
  double fps = 0;       ///< 0: as the sequence says, else 30
  std::int64_t pictures = 300;
  std::uint64_t seed = 1;
  CameraDelays delays;
  std::string can;
  bool watched = false;  ///< flight log, event recorder and live socket as the configuration has them
  std::string json_file;
  std::string plot_file;
  std::vector<std::string> compare;  ///< two configurations or programs
  std::int64_t pairs = 20;           ///< even
  bool quiet = false;
};

/// 0 and above: end the program with that exit code (help, version, mistakes); -1: go on.
int parse_options(int argc, char** argv, Options* options);

}  // namespace godwit::bench
