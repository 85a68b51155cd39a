#include "firmware_app/commands/top_command.h"

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <fmt/format.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include "firmware_app/commands/camera_run.h"
#include "firmware_app/commands/top_screen.h"
#include "firmware_app/config/config.h"
#include "firmware_app/output/live_server.h"
#include "firmware_app/program/exit_code.h"
#include "hal/rt/time.h"

namespace godwit::app {
namespace {

/// godwitd tells something five times a second; who is silent for so long hangs.
constexpr rt::TimeNs kSilentNs = 5 * rt::kNsPerSecond;
constexpr std::size_t kLongestLine = 1 << 20;
constexpr std::size_t kUsualColumns = 100;
constexpr const char* kWhat =
    "Watch a running godwitd: state, quality, rates, latency, map, rung, temperature, last events";

std::size_t columns() {
  winsize size{};
  const bool told = ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 0;
  return told ? size.ws_col : kUsualColumns;
}

class Reader {
 public:
  explicit Reader(int fd) : fd_(fd) {}
  ~Reader() { close(fd_); }
  Reader(const Reader&) = delete;
  Reader& operator=(const Reader&) = delete;

  /// The newest whole line; empty: *stop. Error: it ended, or is silent.
  rt::Result<std::string> next(const std::atomic<bool>& stop) {
    const rt::TimeNs give_up_ns = rt::monotonic_now_ns() + kSilentNs;
    while (!stop.load(std::memory_order_relaxed)) {
      if (const std::size_t end = text_.rfind('\n'); end != std::string::npos) {
        const std::size_t before = end == 0 ? std::string::npos : text_.rfind('\n', end - 1);
        const std::size_t begin = before == std::string::npos ? 0 : before + 1;
        std::string line = text_.substr(begin, end - begin);
        text_.erase(0, end + 1);
        return line;
      }
      if (text_.size() > kLongestLine) return rt::Error{"a line without end: that is no godwitd"};
      if (rt::monotonic_now_ns() > give_up_ns) return rt::Error{"godwitd is silent"};
      pollfd waiting{fd_, POLLIN, 0};
      if (poll(&waiting, 1, 100) <= 0) continue;
      char block[4096];
      const ssize_t n = recv(fd_, block, sizeof block, 0);
      if (n < 0 && errno == EINTR) continue;
      if (n <= 0) return rt::Error{"godwitd has ended"};
      text_.append(block, static_cast<std::size_t>(n));
    }
    return std::string();
  }

 private:
  const int fd_;
  std::string text_;
};

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
  std::string socket = a.socket;
  if (socket.empty() && !a.config_file.empty()) {
    const ConfigReport report = load_config(a.config_file);
    for (const std::string& mistake : report.mistakes) refuse(mistake);
    if (!report.ok()) return kExitRefused;
    socket = report.config.live.socket;
  }
  if (socket.empty()) socket = kServiceSocket;
  const auto connected = connect_live(socket);
  if (!connected) return failed(connected.error().message);
  Reader reader(connected.value());
  const bool screen = !a.once && !a.json && isatty(STDOUT_FILENO) != 0;
  const bool once = a.once || (!a.json && !screen);
  while (true) {
    const auto line = reader.next(stop);
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
