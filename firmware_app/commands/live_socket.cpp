#include "firmware_app/commands/live_socket.h"

#include "firmware_app/commands/camera_run.h"
#include "firmware_app/config/config.h"
#include "firmware_app/output/live_server.h"

namespace godwit::app {

std::optional<std::string> live_socket(const std::string& named, const std::string& config_file) {
  if (!named.empty()) return named;
  std::string socket;
  if (!config_file.empty()) {
    const ConfigReport report = load_config(config_file);
    for (const std::string& mistake : report.mistakes) refuse(mistake);
    if (!report.ok()) return std::nullopt;
    socket = report.config.live.socket;
  }
  return socket.empty() ? kServiceSocket : socket;
}

}  // namespace godwit::app
