#include "firmware_app/commands/view_command.h"

#include <cstdio>
#include <fmt/format.h>

#include "firmware_app/commands/camera_run.h"
#include "firmware_app/commands/live_reader.h"
#include "firmware_app/commands/live_socket.h"
#include "firmware_app/commands/live_watch.h"
#include "firmware_app/commands/page_server.h"
#include "firmware_app/program/exit_code.h"
#include "firmware_app/program/numbers.h"

namespace godwit::app {
namespace {

constexpr const char* kViewWhat =
    "Show a running godwitd to a browser: picture with features and masks, track from above, plots, state, events";
constexpr int kMostPort = 65535;

}  // namespace

void add_view_command(CLI::App* app, ViewArguments* a) {
  CLI::App* const view = app->add_subcommand("view", kViewWhat);
  view->add_option("--socket", a->socket, "Its socket (default: live.socket of --config, or else the service's)")
      ->type_name("PATH");
  view->add_option("--config", a->config_file, "The configuration that it flies with")->type_name("FILE");
  view->add_option("--port", a->port, "Where the page is served; 0: any that is free")
      ->type_name("N")
      ->check(whole_number(0, kMostPort))
      ->capture_default_str();
  view->add_option("--address", a->address,
                   "The address that it listens on. Everybody who reaches another one than this machine's own sees the "
                   "camera's picture")
      ->type_name("ADDRESS")
      ->capture_default_str();
  view->footer(
      "The page only looks, and godwitd is asked only while one is open; it may come, go and come back.\n"
      "Exit codes: 0 ended by Ctrl-C; 2 the page cannot be served there.\n"
      "Example: godwit view --config FILE, and http://127.0.0.1:8712/ in a browser; from another machine first\n"
      "ssh -L 8712:127.0.0.1:8712 HOST");
}

int run_view(const ViewArguments& a, const std::atomic<bool>& stop) {
  const auto socket = live_socket(a.socket, a.config_file);
  if (!socket) return kExitRefused;
  LiveWatch watch(*socket);
  const std::string json = "application/json; charset=utf-8";
  auto server = PageServer::open(a.address, a.port, [&](const std::string& path) -> PageAnswer {
    if (path == "/") return {200, "text/html; charset=utf-8", kViewPage};
    if (path == "/status") return {200, json, watch.status()};
    if (path == "/picture") return {200, json, watch.picture()};
    if (path == "/track") return {200, json, watch.track()};
    return {404, "text/plain; charset=utf-8", "there is nothing here; the page is /\n"};
  });
  if (!server) return refuse(server.error().message);
  const bool six = a.address.find(':') != std::string::npos;
  fmt::print("http://{}{}{}:{}/ shows {}\n", six ? "[" : "", a.address, six ? "]" : "", server.value()->port(),
             *socket);
  if (!server.value()->local()) fmt::print("whoever reaches this address sees it\n");
  if (std::fflush(stdout) != 0) return kExitFailed;
  server.value()->run(stop);
  return kExitDone;
}

}  // namespace godwit::app
