// The end of godwitd, whoever hangs: also the main thread, at a device or a port that does not close.
#pragma once

#include <atomic>
#include <functional>
#include <mutex>
#include <string>

#include "hal/rt/thread.h"
#include "hal/rt/wake_up.h"

namespace godwit::app {

/// Who beside the user may want the process to end: the link, by an order over the bus. Any thread, no wait; null:
/// false.
struct EndWishes {
  std::function<bool()> end;
  std::function<bool()> restart;  ///< the end is for a start anew: kExitRestart
};

/// A thread of its own, gw-end. From when the end is asked for it has kProcessEndNs (hal/rt/process_end.h): who waits
/// names whom it waits for; where nobody has done so by then, the process ends all the same.
class EndGuard {
 public:
  /// stop outlives it. plan: of its thread. Until it is destroyed it is who is called for devices' threads that hang.
  EndGuard(const std::atomic<bool>& stop, const rt::ThreadPlan& plan);
  ~EndGuard();
  EndGuard(const EndGuard&) = delete;
  EndGuard& operator=(const EndGuard&) = delete;

  /// From now on these count, too; {}: no more, before what they ask is destroyed. A restart once wished stays wished.
  void watch(EndWishes wishes);
  /// Ends the process without this thread. Any thread.
  [[noreturn]] void abandon(const char* thread);
  /// No thread could be had. In words; empty: all well.
  const std::string& trouble() const { return trouble_; }

 private:
  void run();
  bool asked();

  const std::atomic<bool>& stop_;
  std::string trouble_;
  std::mutex mutex_;
  EndWishes wishes_;                 ///< under mutex_
  bool restart_ = false;             ///< under mutex_: a start anew was wished for
  std::atomic<bool> ending_{false};  ///< destructor -> thread; relaxed, nothing is ordered by it
  rt::WakeUp wake_;
  rt::Thread thread_;
};

}  // namespace godwit::app
