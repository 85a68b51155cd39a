// Figures as a table for people and as JSON for programs.
#pragma once

#include <string>
#include <vector>

#include "benchmarks/latency/figures.h"
#include "benchmarks/latency/options.h"

namespace godwit::bench {

/// What was flown, said once for all flights.
struct Run {
  std::string input;
  std::string config_file;
  double fps = 0;
  CameraDelays delays;  ///< simulated cameras
  bool live = false;
  std::vector<FlightFigures> flights;
};

/// Lines for people.
std::string table(const Run& run);

/// One JSON object, schema docs/figures.schema.json, kind "latency".
std::string json(const Run& run);

}  // namespace godwit::bench
