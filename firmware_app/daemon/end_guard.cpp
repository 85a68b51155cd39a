#include "firmware_app/daemon/end_guard.h"

#include <utility>

#include "firmware_app/program/exit_code.h"
#include "firmware_app/program/program.h"
#include "hal/rt/process_end.h"

namespace godwit::app {
namespace {

constexpr rt::TimeNs kEndLookNs = 50 * rt::kNsPerMs;
/// After the process's end: whoever waits for somebody has a better name for what hangs.
constexpr rt::TimeNs kOthersFirstNs = 500 * rt::kNsPerMs;

}  // namespace

EndGuard::EndGuard(const std::atomic<bool>& stop, const rt::ThreadPlan& plan) : stop_(stop) {
  rt::abandon_threads_by([this](const char* thread) { abandon(thread); });
  if (const auto started = thread_.start("gw-end", plan, [this] { run(); }); !started) {
    trouble_ = started.error().message;
  }
}

EndGuard::~EndGuard() {
  ending_.store(true, std::memory_order_relaxed);
  wake_.post();
  rt::join_in_time(&thread_);
  rt::abandon_threads_by(nullptr);
}

void EndGuard::watch(EndWishes wishes) {
  const std::lock_guard<std::mutex> lock(mutex_);
  restart_ = restart_ || (wishes_.restart && wishes_.restart());
  wishes_ = std::move(wishes);
}

void EndGuard::abandon(const char* thread) {
  bool restart = false;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    restart = restart_ || (wishes_.restart && wishes_.restart());
  }
  end_without("godwitd", thread, restart ? kExitRestart : kExitFailed);
}

bool EndGuard::asked() {
  if (stop_.load(std::memory_order_relaxed)) return true;
  const std::lock_guard<std::mutex> lock(mutex_);
  return wishes_.end && wishes_.end();
}

void EndGuard::run() {
  while (!ending_.load(std::memory_order_relaxed)) {
    if (asked()) rt::begin_process_end();
    const rt::TimeNs end_ns = rt::process_end_ns();
    if (end_ns != rt::kNoEnd && rt::monotonic_now_ns() > end_ns + kOthersFirstNs) abandon("the main thread");
    wake_.wait_for(kEndLookNs);
  }
}

}  // namespace godwit::app
