// A thread with a name, processors and a real-time priority, on a stack that is fixed, touched and measured.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <pthread.h>
#include <string>
#include <vector>

#include "hal/rt/result.h"
#include "hal/rt/wake_up.h"

namespace godwit::rt {

/// How a thread is to run. Default: as any thread does.
struct ThreadPlan {
  std::vector<int> cpus;  ///< it may run on these only; empty: on all
  int priority = 0;       ///< 1 to 99: SCHED_FIFO with this priority; 0: the ordinary scheduler
};

/// Stack of every thread of the pipeline. The sanitizers' frames are several times as large.
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
constexpr std::size_t kThreadStackBytes = 4096 * 1024;
#else
constexpr std::size_t kThreadStackBytes = 512 * 1024;
#endif

/// Gives the calling thread name (at most 15 bytes are kept), processors and priority. What the machine refuses is left
/// as it was and told in words; empty: all done. Blocks and allocates; before arming.
std::string apply_plan(pthread_t thread, const char* name, const ThreadPlan& plan);

/// One running thread. start() and join() belong to one thread, its owner.
class Thread {
 public:
  Thread() = default;
  /// Precondition: joined, or never started.
  ~Thread();
  Thread(const Thread&) = delete;
  Thread& operator=(const Thread&) = delete;

  /// Runs body on a new thread. The stack is mapped and touched here, so that running on it faults no page later, with
  /// a page below it that may not be touched; body begins when the plan holds. Missing privileges do not fail: see
  /// warning(). Error: no memory, no
  /// thread.
  Result<void> start(const char* name, const ThreadPlan& plan, std::function<void()> body);
  /// Waits until body has returned.
  void join();

  bool running() const { return running_; }  ///< started and not joined
  /// Body has returned; a join takes no time. Acquire, partner: the release store after it.
  bool ended() const { return ended_.load(std::memory_order_acquire); }
  const char* name() const { return name_.c_str(); }  ///< as it was started

  /// What of the plan the machine refused, in words; empty: nothing.
  const std::string& warning() const { return warning_; }
  /// Deepest that the stack was used so far [bytes]. Exact after join().
  std::size_t stack_used() const;

 private:
  static void* run(void* self);
  std::size_t stack_used_now() const;

  std::function<void()> body_;
  std::string name_, warning_;
  WakeUp planned_;
  std::uint8_t* stack_ = nullptr;  ///< guard page first
  std::size_t stack_at_end_ = 0;   ///< the thread's own until join(), which orders it
  pthread_t id_{};
  std::atomic<bool> ended_{false};
  bool running_ = false;
};

}  // namespace godwit::rt
