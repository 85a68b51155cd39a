// What a service tells systemd: that it is ready, what it does, that it lives. The protocol of sd_notify(3), in
// datagrams. Not libsystemd's call: that opens a socket each time and allocates, and the watchdog is fed by a thread
// that must live when memory or discs do not.
#pragma once

#include <string>
#include <string_view>
#include <sys/socket.h>
#include <sys/un.h>

#include "hal/rt/time.h"

namespace godwit::hal {

/// Speaks to the service manager that started this process; to nobody where none did. Not to be copied.
class ServiceManager {
 public:
  /// Reads NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID; before other threads run.
  ServiceManager();
  ~ServiceManager();
  ServiceManager(const ServiceManager&) = delete;
  ServiceManager& operator=(const ServiceManager&) = delete;

  bool present() const { return socket_ >= 0; }
  /// How soon it wants to hear alive() again; 0: it does not watch.
  rt::TimeNs watchdog_ns() const { return watchdog_ns_; }

  /// Any thread; no allocation, never waits: what the manager does not take at once is lost. False: not taken.
  bool ready() const { return send("READY=1"); }
  bool alive() const { return send("WATCHDOG=1"); }
  bool stopping() const { return send("STOPPING=1"); }
  /// One line for `systemctl status`. Allocates.
  bool status(const std::string& line) const { return send("STATUS=" + line); }

 private:
  bool send(std::string_view message) const;

  int socket_ = -1;
  sockaddr_un address_{};
  socklen_t address_bytes_ = 0;
  rt::TimeNs watchdog_ns_ = 0;
};

}  // namespace godwit::hal
