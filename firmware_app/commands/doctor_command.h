// `godwit doctor`: is everything there and set so that this vehicle can fly on our poses?
#pragma once

#include <CLI/App.hpp>
#include <atomic>
#include <string>

namespace godwit::app {

struct DoctorArguments {
  std::string config_file;  ///< empty: defaults
  std::string can, mavlink;
  std::string sequence;
  int delay_ms = -1;  ///< what a flight told as VISO_DELAY_MS; -1: not known
  bool tilt = false;
};

/// Describes the command to the parser; *arguments outlives it.
void add_doctor_command(CLI::App* app, DoctorArguments* arguments);

/// Runs it; ends early when *stop becomes true. kExitDone only where all fits, kExitFailed where something does not.
int run_doctor(const DoctorArguments& arguments, const std::atomic<bool>& stop);

}  // namespace godwit::app
