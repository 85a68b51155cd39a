// What each thread of this process uses, read from the kernel now and then while they run.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "benchmarks/latency/figures.h"
#include "hal/rt/time.h"

namespace godwit::bench {

/// Looks into /proc/self/task (proc(5): comm, schedstat, status). Threads are gone when a run has ended, so it is asked
/// while they live. One thread; blocks and allocates.
class ThreadWatch {
 public:
  /// Looks once; the first look is what later ones are compared with.
  void look(rt::TimeNs now_ns);
  /// From each thread's first look to its last; threads of one name are added up. By CPU share, highest first.
  std::vector<ThreadUse> uses() const;

 private:
  struct Reading {
    std::string name;
    rt::TimeNs t_ns = 0;
    double cpu_ns = 0;
    std::uint64_t waits = 0, preemptions = 0;
  };
  struct Thread {
    Reading first, last;
  };
  std::map<std::string, Thread> threads_;  ///< by thread id
};

}  // namespace godwit::bench
