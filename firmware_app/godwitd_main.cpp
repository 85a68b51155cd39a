// The daemon. `godwitd --config FILE`; SIGTERM ends it.
#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <atomic>
#include <csignal>
#include <cstdio>
#include <exception>

#include "firmware_app/commands/exit_code.h"
#include "firmware_app/daemon/config_check.h"
#include "firmware_app/daemon/daemon.h"

namespace {

// Written by the signal handler, read by the pipeline; lock-free, as a handler needs it.
std::atomic<bool> stop{false};
static_assert(std::atomic<bool>::is_always_lock_free);

void on_signal(int /*signal*/) {
  stop.store(true, std::memory_order_relaxed);
}

int run(int argc, char** argv) {
  using namespace godwit::app;
  CLI::App app("Visual navigation without satellites, as a daemon.", "godwitd");
  app.set_version_flag("--version", "godwitd " GODWIT_VERSION);
  std::string file;
  app.add_option("--config", file, "Configuration (TOML); config/godwit.toml lists every key")
      ->type_name("FILE")
      ->required();
  app.footer("Exit codes: 0 ended by SIGTERM or SIGINT; 1 failed on the way; 2 did not start.");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? kExitDone : kExitRefused;
  }
  ConfigReport report = load_config(file);
  if (report.ok()) check_for_daemon(&report);
  for (const std::string& mistake : report.mistakes) std::fprintf(stderr, "godwitd: %s\n", mistake.c_str());
  return report.ok() ? run_daemon(report.config, stop) : static_cast<int>(kExitRefused);
}

}  // namespace

int main(int argc, char** argv) {
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
  try {
    return run(argc, argv);
  } catch (const std::exception& e) {  // std::bad_alloc, or a library that throws where it should not
    std::fprintf(stderr, "godwitd: %s\n", e.what());
    return godwit::app::kExitFailed;
  }
}
