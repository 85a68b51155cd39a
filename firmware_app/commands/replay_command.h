// `godwit replay`: a recorded sequence through the pipeline, a pose for every frame out.
#pragma once

#include <CLI/App.hpp>
#include <atomic>
#include <cstdint>
#include <string>

#include "firmware_app/commands/camera_run.h"
#include "firmware_app/commands/foreign_sequence.h"
#include "firmware_app/config/config.h"

namespace godwit::app {

struct ReplayArguments : RunOptions {
  std::string sequence;
  VideoCamera video;              ///< replay only
  std::string config_file;        ///< empty: defaults
  std::string write_calibration;  ///< file; empty: none. replay only
  std::int64_t loop = 1;          ///< passes, forth and back in turn; replay only
  std::string detector, gate;     ///< "on" or "off"; empty: as the configuration file says, off where it does not
  std::string imu = "off";
  std::string aids;  ///< --aids: what else tells lengths; empty: nothing
  std::string model;
  std::string can, mavlink;  ///< empty: as configured
  bool bench_metric = false;
};

/// Describes the command to the parser; *arguments outlives it.
void add_replay_command(CLI::App* app, ReplayArguments* arguments);

/// The options that every command has that runs a camera through the pipeline: all but SEQUENCE.
void add_run_options(CLI::App* command, ReplayArguments* arguments);
/// --can and --mavlink, which every command has that speaks to an autopilot.
void add_link_options(CLI::App* command, std::string* can, std::string* mavlink);
/// Puts them, where given, over what the configuration says; tells what is wrong. False: refused.
bool take_link_options(const std::string& can, const std::string& mavlink, Config* config);
/// Tells what is wrong with them, or reads the configuration they name into *config. False: refused.
bool check_run_arguments(const ReplayArguments& arguments, Config* config);

/// --aids names the attitude.
bool tells_attitude(const ReplayArguments& arguments);

/// Runs it; ends early when *stop becomes true. Returns an ExitCode.
int run_replay(const ReplayArguments& arguments, const std::atomic<bool>& stop);

}  // namespace godwit::app
