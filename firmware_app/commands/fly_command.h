// `godwit fly`: a simulated flight through the pipeline, a pose for every frame out, and the truth beside it.
#pragma once

#include <CLI/App.hpp>
#include <atomic>

#include "firmware_app/commands/replay_command.h"
#include "firmware_app/commands/sim_command.h"

namespace godwit::app {

struct FlyArguments {
  FlightArguments flight;
  ReplayArguments run;  ///< its sequence is not used
  bool truth_masks = false;
  bool render_ahead = false;
};

/// Describes the command to the parser; *arguments outlives it.
void add_fly_command(CLI::App* app, FlyArguments* arguments);

/// Runs it; ends early when *stop becomes true. Returns an ExitCode.
int run_fly(const FlyArguments& arguments, const std::atomic<bool>& stop);

}  // namespace godwit::app
