#include "hal/machine/service_manager.h"

#include <charconv>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <unistd.h>

namespace godwit::hal {
namespace {

std::int64_t number_in(const char* name) {
  const char* const text = std::getenv(name);
  std::int64_t out = 0;
  if (text == nullptr) return 0;
  const auto [end, error] = std::from_chars(text, text + std::strlen(text), out);
  return error == std::errc() && *end == '\0' && out > 0 ? out : 0;
}

}  // namespace

ServiceManager::ServiceManager() {
  const char* const path = std::getenv("NOTIFY_SOCKET");
  if (path == nullptr || (path[0] != '/' && path[0] != '@')) return;
  const std::size_t length = std::strlen(path);
  if (length >= sizeof(address_.sun_path)) return;
  address_.sun_family = AF_UNIX;
  std::memcpy(address_.sun_path, path, length);
  if (path[0] == '@') address_.sun_path[0] = '\0';  // an abstract name: no file
  address_bytes_ = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + length);
  socket_ = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  // WATCHDOG_PID: a child that inherits the environment is not the one that is watched.
  const std::int64_t pid = number_in("WATCHDOG_PID");
  if (pid == 0 || pid == getpid()) watchdog_ns_ = number_in("WATCHDOG_USEC") * 1000;
}

ServiceManager::~ServiceManager() {
  if (socket_ >= 0) close(socket_);
}

bool ServiceManager::send(std::string_view message) const {
  if (socket_ < 0) return false;
  const auto sent = sendto(socket_, message.data(), message.size(), MSG_DONTWAIT | MSG_NOSIGNAL,
                           reinterpret_cast<const sockaddr*>(&address_), address_bytes_);
  return sent == static_cast<ssize_t>(message.size());
}

}  // namespace godwit::hal
