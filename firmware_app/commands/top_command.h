// `godwit top`: what a running godwitd does, a few times a second.
#pragma once

#include <CLI/App.hpp>
#include <atomic>
#include <string>

namespace godwit::app {

struct TopArguments {
  std::string socket;       ///< empty: of the configuration, or the service's
  std::string config_file;  ///< empty: none
  bool once = false;
  bool json = false;
};

/// Describes the command to the parser; *arguments outlives it.
void add_top_command(CLI::App* app, TopArguments* arguments);

/// Runs until godwitd ends or *stop becomes true. Returns an ExitCode.
int run_top(const TopArguments& arguments, const std::atomic<bool>& stop);

}  // namespace godwit::app
