// `godwit check`: everything that is wrong with a configuration, before a flight and all at once.
#pragma once

#include <CLI/App.hpp>
#include <string>

namespace godwit::app {

struct CheckArguments {
  std::string config_file;
  bool show = false;
  bool keys = false;
};

/// Describes the command to the parser; *arguments outlives it.
void add_check_command(CLI::App* app, CheckArguments* arguments);

/// Tells every mistake on the error stream, or that there is none. Returns kExitDone or kExitRefused.
int run_check(const CheckArguments& arguments);

}  // namespace godwit::app
