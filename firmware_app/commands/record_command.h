// `godwit record`: the devices of a configuration into a folder. `godwit calibrate imu`: noise figures of such a
// folder.
#pragma once

#include <CLI/App.hpp>
#include <atomic>
#include <string>

namespace godwit::app {

struct RecordArguments {
  std::string config;
  std::string out;
  double seconds = 0;
  bool no_camera = false;
};

struct CalibrateArguments {
  std::string recording;
  std::string out;
  std::string plot;
};

/// Describe the commands to the parser; *arguments outlives it.
void add_record_command(CLI::App* app, RecordArguments* arguments);
void add_calibrate_command(CLI::App* app, CalibrateArguments* arguments);

/// Run them. Return an ExitCode.
int run_record(const RecordArguments& arguments, const std::atomic<bool>& stop);
int run_calibrate_imu(const CalibrateArguments& arguments);

}  // namespace godwit::app
