// `godwit view`: a page that shows a running godwitd to a browser. It can only look.
#pragma once

#include <CLI/App.hpp>
#include <atomic>
#include <string>

namespace godwit::app {

constexpr int kViewPort = 8712;

struct ViewArguments {
  std::string socket;       ///< empty: of the configuration, or the service's
  std::string config_file;  ///< empty: none
  std::string address = "127.0.0.1";
  int port = kViewPort;
};

/// The page itself, commands/view_page.html.
extern const char* const kViewPage;

/// Describes the command to the parser; *arguments outlives it.
void add_view_command(CLI::App* app, ViewArguments* arguments);

/// Serves until *stop becomes true. Returns an ExitCode.
int run_view(const ViewArguments& arguments, const std::atomic<bool>& stop);

}  // namespace godwit::app
