// One thread of the pipeline: its sign of life, its end, and how it fared.
#pragma once

#include <atomic>
#include <functional>

#include "firmware_app/pipeline/pipeline.h"
#include "hal/rt/heartbeat.h"
#include "hal/rt/memory.h"
#include "hal/rt/thread.h"
#include "hal/rt/wake_up.h"

namespace godwit::app {

/// All calls by the owner of the run.
class PartThread {
 public:
  /// Static text: the thread's name, and how the report calls it.
  PartThread(const char* name, const char* report_name) : name_(name), report_name_(report_name) {}

  /// Runs body with the pulse that it is to beat; page faults are counted around it. heartbeats: null, nobody watches;
  /// `at_end` is posted when it has nothing left to do.
  rt::Result<void> start(const rt::ThreadPlan& plan, rt::Heartbeats* heartbeats, rt::TimeNs patience_ns,
                         rt::WakeUp* at_end, std::function<void(rt::Pulse*)> body);
  void join() { thread_.join(); }

  const char* name() const { return name_; }
  bool running() const { return thread_.running(); }
  /// It has nothing left to do; a join returns at once. Acquire, partner: the release store at its end.
  bool ended() const { return ended_.load(std::memory_order_acquire); }
  const std::string& warning() const { return thread_.warning(); }
  /// After join(). stack_used 0: it never ran.
  ThreadReport report() const { return {report_name_, faults_, thread_.stack_used()}; }

 private:
  const char* const name_;
  const char* const report_name_;
  rt::Pulse pulse_;
  rt::PageFaults faults_;  ///< the thread's own until it was joined
  std::atomic<bool> ended_{false};
  rt::Thread thread_;
};

}  // namespace godwit::app
