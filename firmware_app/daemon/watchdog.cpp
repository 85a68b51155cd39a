#include "firmware_app/daemon/watchdog.h"

#include "hal/rt/process_end.h"

namespace godwit::app {
namespace {

/// Asked so often between two signs that systemd wants: one that comes late by chance is not the last one in time.
constexpr int kSignsAPeriod = 4;

}  // namespace

Watchdog::Watchdog(const hal::ServiceManager& manager, const rt::Heartbeats& heartbeats, const rt::ThreadPlan& plan)
    : manager_(manager), heartbeats_(heartbeats) {
  if (manager.watchdog_ns() == 0) return;
  if (const auto started = thread_.start("gw-watchdog", plan, [this] { run(); }); !started) {
    trouble_ = started.error().message;
  }
}

Watchdog::~Watchdog() {
  ending_.store(true, std::memory_order_relaxed);
  wake_.post();
  rt::join_in_time(&thread_);
}

void Watchdog::run() {
  while (!ending_.load(std::memory_order_relaxed)) {
    const auto silent = heartbeats_.silent(rt::monotonic_now_ns(), {"gw-camera", "gw-tracker", "gw-mapper", "gw-link"});
    if (silent.name == nullptr) manager_.alive();
    wake_.wait_for(manager_.watchdog_ns() / kSignsAPeriod);
  }
}

}  // namespace godwit::app
