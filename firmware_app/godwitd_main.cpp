// The daemon. `godwitd --config FILE`; SIGTERM ends it.
#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <atomic>
#include <cstdlib>

#include "firmware_app/config/version.h"
#include "firmware_app/daemon/daemon.h"
#include "firmware_app/flight/config_check.h"
#include "firmware_app/output/line_log.h"
#include "firmware_app/program/exit_code.h"
#include "firmware_app/program/program.h"
#include "hal/rt/memory.h"

namespace {

int run(int argc, char** argv, const std::atomic<bool>& stop) {
  using namespace godwit::app;
  CLI::App app("Visual navigation without satellites, as a daemon.", "godwitd");
  app.set_version_flag("--version", "godwitd " + version_words(version()));
  std::string file;
  app.add_option("--config", file, "Configuration (TOML); config/godwit.toml lists every key")
      ->type_name("FILE")
      ->required();
  app.footer(
      "Exit codes: 0 ended by SIGTERM or SIGINT; 1 failed on the way; 2 did not start;\n"
      "75 restart asked for over the bus.");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? kExitDone : kExitRefused;
  }
  ConfigReport report = load_config(file);
  // Under systemd (StateDirectory=) what is to be kept has a folder, unless the configuration names another.
  const char* const state = std::getenv("STATE_DIRECTORY");
  if (state != nullptr && report.config.link.state_folder.empty()) report.config.link.state_folder = state;
  // The same of what lasts as long as the service (RuntimeDirectory=).
  const char* const runtime = std::getenv("RUNTIME_DIRECTORY");
  if (runtime != nullptr && report.config.live.socket.empty())
    report.config.live.socket = std::string(runtime) + "/live";
  if (report.ok()) check_for_daemon(&report);
  for (const std::string& mistake : report.mistakes) error_log().put("godwitd: " + mistake);
  return report.ok() ? run_daemon(report.config, stop) : static_cast<int>(kExitRefused);
}

}  // namespace

/// For threads without a plan: the log's and the one that keeps parameters.
constexpr std::size_t kUnplannedStackBytes = std::size_t{1} << 20;

int main(int argc, char** argv) {
  godwit::rt::limit_unplanned_stacks(kUnplannedStackBytes);
  return godwit::app::run_program("godwitd", run, argc, argv);
}
