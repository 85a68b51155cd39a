#include "firmware_app/commands/top_command.h"

#include <cstdio>
#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "firmware_app/commands/camera_run.h"
#include "firmware_app/commands/live_reader.h"
#include "firmware_app/commands/live_socket.h"
#include "firmware_app/commands/top_screen.h"
#include "firmware_app/output/live_server.h"
#include "firmware_app/program/exit_code.h"

namespace godwit::app {
namespace {

constexpr std::size_t kUsualColumns = 100;
constexpr const char* kWhat =
    "Watch a running godwitd: state, quality, rates, latency, map, rung, temperature, last events";

std::size_t columns() {
  winsize size{};
  const bool told = ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 0;
  return told ? size.ws_col : kUsualColumns;
}

}  // namespace

void add_top_command(CLI::App* app, TopArguments* a) {
  CLI::App* const top = app->add_subcommand("top", kWhat);
  top->add_option("--socket", a->socket, "Its socket (default: live.socket of --config, or else the service's)")
      ->type_name("PATH");
  top->add_option("--config", a->config_file, "The configuration that it flies with")->type_name("FILE");
  top->add_flag("--once", a->once, "Show it once, as plain lines; so it is, too, where the output is no terminal");
  top->add_flag("--json", a->json, "As godwitd tells it, a line of JSON five times a second (docs/live.md)");
  top->footer("Exit codes: 0 shown, or ended by Ctrl-C; 1 nobody is there, or it ended.\nExample: godwit top --once");
}

int run_top(const TopArguments& a, const std::atomic<bool>& stop) {
  const auto socket = live_socket(a.socket, a.config_file);
  if (!socket) return kExitRefused;
  const auto connected = connect_live(*socket);
  if (!connected) return failed(connected.error().message);
  LiveReader reader(connected.value());
  const bool screen = !a.once && !a.json && isatty(STDOUT_FILENO) != 0;
  const bool once = a.once || (!a.json && !screen);
  while (true) {
    const auto line = reader.newest(stop);
    if (!line) return failed(line.error().message);
    if (line.value().empty()) return kExitDone;
    const auto shown = top_screen(line.value(), screen ? columns() : std::size_t{1000});
    if (!shown) return failed(shown.error().message);
    if (a.json) {
      fmt::print("{}\n", line.value());
    } else {
      // To the top left, and what was there before is gone.
      fmt::print("{}{}", screen ? "\x1b[H\x1b[2J" : "", shown.value());
    }
    if (std::fflush(stdout) != 0) return kExitFailed;
    if (once) return kExitDone;
  }
}

}  // namespace godwit::app
