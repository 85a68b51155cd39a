// `godwit sim`: a simulated flight written as a folder that this and other systems can run on.
#pragma once

#include <CLI/App.hpp>
#include <atomic>
#include <cstdint>
#include <memory>
#include <string>

#include "hal/rt/result.h"
#include "hal/sim/flight/flight.h"

namespace godwit::app {

/// Which flight: shared by all commands that simulate.
struct FlightArguments {
  std::string scenario;
  std::string folder;  ///< where scenarios are looked up; empty: those that come with godwit
  std::uint64_t seed = 1;
  bool imu_faults = false;  ///< beside those of the scenario
};

struct SimArguments {
  FlightArguments flight;
  std::string out;
  std::string format = "jpg";
  int start = 0;
  int frames = 0;  ///< 0: all
};

/// Adds SCENARIO, --seed, --scenarios and --imu-faults.
void add_flight_options(CLI::App* command, FlightArguments* arguments);
/// Reads the scenario and makes its world. Error: what is wrong with the file, or a flight that hits something.
rt::Result<std::unique_ptr<sim::Flight>> make_flight(const FlightArguments& arguments);

/// Describes the command to the parser; *arguments outlives it.
void add_sim_command(CLI::App* app, SimArguments* arguments);
/// Runs it; ends early when *stop becomes true. Returns an ExitCode.
int run_sim(const SimArguments& arguments, const std::atomic<bool>& stop);

}  // namespace godwit::app
