// `godwit record`: the devices of a configuration into a folder. `godwit calibrate imu`: noise figures of such a
// folder. `godwit calibrate camera`: a camera's calibration from pictures of a board.
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
  CLI::App* camera_command = nullptr;
  struct {
    std::string folder, config, size, board, model = "radtan", out;
    double seconds = 0, fps = 0;
  } camera;
};

/// Describe the commands to the parser; *arguments outlives it.
void add_record_command(CLI::App* app, RecordArguments* arguments);
void add_calibrate_command(CLI::App* app, CalibrateArguments* arguments);

/// Run them. Return an ExitCode.
int run_record(const RecordArguments& arguments, const std::atomic<bool>& stop);
int run_calibrate(const CalibrateArguments& arguments, const std::atomic<bool>& stop);
int run_calibrate_imu(const CalibrateArguments& arguments);
int run_calibrate_camera(const CalibrateArguments& arguments, const std::atomic<bool>& stop);

}  // namespace godwit::app
