#include "firmware_app/flight/live_plan.h"

#include <algorithm>
#include <charconv>
#include <limits>
#include <optional>

#include "firmware_app/config/version.h"

namespace godwit::app {
namespace {

bool may_be_looked_at(const Config& config) {
  return config.live.enabled && !config.live.socket.empty();
}

/// "key = 12.5"; none: its value is no figure.
std::optional<std::pair<std::string, double>> figure_of(const std::string& line) {
  const auto equals = line.find(" = ");
  if (equals == std::string::npos) return std::nullopt;
  const std::string value = line.substr(equals + 3);
  if (value == "true" || value == "false") return std::pair(line.substr(0, equals), value == "true" ? 1.0 : 0.0);
  double figure = 0;
  const auto [end, error] = std::from_chars(value.data(), value.data() + value.size(), figure);
  if (error != std::errc() || end != value.data() + value.size()) return std::nullopt;
  return std::pair(line.substr(0, equals), figure);
}

FlightLogOptions log_options(const Config& config) {
  FlightLogOptions out;
  std::string text;
  for (const std::string& line : show_config(config)) {
    text += line + "\n";
    if (const auto figure = figure_of(line)) out.parameters.push_back(*figure);
  }
  out.info.emplace_back("version", version_words(version()));
  out.info.emplace_back("ver_sw", commit_words(version()));
  out.info.emplace_back("configuration", std::move(text));
  return out;
}

}  // namespace

std::unique_ptr<FlightLog> begin_flight_log_in(const std::string& folder, const Config& config) {
  FlightLogOptions options = log_options(config);
  options.folder = folder;
  options.budget_bytes = std::numeric_limits<std::size_t>::max();
  return std::make_unique<FlightLog>(std::move(options));
}

std::unique_ptr<FlightLog> begin_flight_log(const Config& config, const Say& say) {
  const bool own_folder = !config.flight_log.folder.empty();
  if (!config.flight_log.enabled || (!own_folder && config.link.state_folder.empty())) return nullptr;
  FlightLogOptions options = log_options(config);
  options.folder = own_folder ? config.flight_log.folder : config.link.state_folder + "/flights";
  options.budget_bytes = static_cast<std::size_t>(config.flight_log.budget_mb) * 1'000'000;
  options.file_bytes = std::min(options.file_bytes, options.budget_bytes / 8);
  say("flight log: " + options.folder);
  return std::make_unique<FlightLog>(std::move(options));
}

std::unique_ptr<LivePicture> live_picture(const Config& config, int width, int height) {
  return may_be_looked_at(config) ? std::make_unique<LivePicture>(width, height) : nullptr;
}

std::unique_ptr<LiveServer> begin_live(const Config& config, Live* live, LivePicture* picture, const Say& say,
                                       std::function<void(const char*)> abandon) {
  if (!may_be_looked_at(config)) return nullptr;
  LiveServerOptions options;
  options.socket = config.live.socket;
  options.abandon = std::move(abandon);
  options.line = [live] { return live->status.snapshot(rt::monotonic_now_ns()); };
  options.view = [live, picture](std::string* lines) {
    const rt::TimeNs now_ns = rt::monotonic_now_ns();
    picture->add_line(now_ns, lines);
    live->track.add_line(now_ns, lines);
  };
  auto server = LiveServer::start(std::move(options));
  if (!server) {
    say("warning: live: " + server.error().message);
    return nullptr;
  }
  say("live: " + config.live.socket);
  return std::move(server).value();
}

}  // namespace godwit::app
