#include "firmware_app/commands/check_command.h"

#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <fmt/format.h>
#include <optional>
#include <unistd.h>

#include "firmware_app/config/link_settings.h"
#include "firmware_app/flight/config_check.h"
#include "firmware_app/link/saved_parameters.h"
#include "firmware_app/program/exit_code.h"

namespace godwit::app {

void add_check_command(CLI::App* app, CheckArguments* a) {
  CLI::App* check =
      app->add_subcommand("check", "Look over a configuration as godwitd would, and tell all that is wrong");
  check->add_option("--config", a->config_file, "Configuration (TOML); config/godwit.toml lists every key")
      ->type_name("FILE");
  check->add_flag("--show", a->show, "Also print every key with the value it would have");
  check->add_flag("--keys", a->keys, "Print every key with its default and what is allowed, and nothing else");
  check->footer(
      "Exit codes: 0 godwitd would start with it; 2 it would not.\nExample: godwit check --config /etc/godwit.toml");
}

int run_check(const CheckArguments& a) {
  if (a.keys) {
    for (const std::string& line : describe_config()) fmt::print("{}\n", line);
    return kExitDone;
  }
  if (a.config_file.empty()) {
    fmt::print(stderr, "godwit: --config: a file is needed, or --keys\n");
    return kExitRefused;
  }
  ConfigReport report = load_config(a.config_file);
  // What is out of range by itself has its default here, so the rest can be looked at as well.
  if (!report.lines.empty() || report.ok()) check_for_daemon(&report);
  for (const std::string& mistake : report.mistakes) fmt::print(stderr, "{}\n", mistake);
  if (a.show) {
    for (const std::string& line : show_config(report.config)) fmt::print("{}\n", line);
  }
  if (!report.ok()) {
    fmt::print(stderr, "{}: {} mistake{}\n", a.config_file, report.mistakes.size(),
               report.mistakes.size() == 1 ? "" : "s");
    return kExitRefused;
  }
  const link::LinkSettings settings = link_settings(report.config, std::nullopt);
  if (wants_link(report.config) && !settings.state_folder.empty()) {
    if (access(settings.state_folder.c_str(), W_OK | X_OK) != 0) {
      fmt::print("{}: warning: {} cannot be written to: nothing will be kept\n", a.config_file, settings.state_folder);
    }
    link::StoredState saved = link::Storage(settings.state_folder).peek(settings.link.parameters);
    // Whether the interface takes CAN FD is seen when it is opened.
    link::drop_what_does_not_fit(settings.link.parameters, {!settings.can.empty(), !settings.mavlink.empty(), true},
                                 &saved);
    for (const std::string& line : saved.warnings) fmt::print("{}: warning: {}\n", a.config_file, line);
    for (const std::string& line : link::overrides(settings.link.parameters, saved)) {
      fmt::print("{}: {}\n", a.config_file, line);
    }
  }
  fmt::print("{}: ok\n", a.config_file);
  return kExitDone;
}

}  // namespace godwit::app
