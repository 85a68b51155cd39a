// Signs of life to systemd, while the threads that a flight needs all live.
#pragma once

#include <atomic>
#include <string>

#include "hal/machine/service_manager.h"
#include "hal/rt/heartbeat.h"
#include "hal/rt/thread.h"
#include "hal/rt/wake_up.h"

namespace godwit::app {

/// A thread of its own, gw-watchdog, that touches neither disc nor log: camera, tracker, mapper and link together feed
/// it. A detector that hangs is shed, and a disc or a log that hangs is nobody's end: they are not asked. Without a
/// service manager that watches it does nothing.
class Watchdog {
 public:
  /// Both outlive it. plan: of its thread.
  Watchdog(const hal::ServiceManager& manager, const rt::Heartbeats& heartbeats, const rt::ThreadPlan& plan);
  ~Watchdog();
  Watchdog(const Watchdog&) = delete;
  Watchdog& operator=(const Watchdog&) = delete;

  /// No thread could be had: systemd will end the process. In words; empty: all well.
  const std::string& trouble() const { return trouble_; }

 private:
  void run();

  const hal::ServiceManager& manager_;
  const rt::Heartbeats& heartbeats_;
  std::string trouble_;
  std::atomic<bool> ending_{false};  ///< destructor -> thread; relaxed, nothing is ordered by it
  rt::WakeUp wake_;
  rt::Thread thread_;
};

}  // namespace godwit::app
