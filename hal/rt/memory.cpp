#include "hal/rt/memory.h"

#include <cerrno>
#include <cstring>
#include <pthread.h>
#include <sys/mman.h>
#include <sys/resource.h>

namespace godwit::rt {

std::string lock_memory() {
  if (mlockall(MCL_CURRENT | MCL_FUTURE) == 0) return {};
  std::string why = std::string("memory is not locked: ") + std::strerror(errno);
  rlimit limit{};
  if (getrlimit(RLIMIT_MEMLOCK, &limit) == 0 && limit.rlim_cur != RLIM_INFINITY) {
    why += "; the limit is " + std::to_string(limit.rlim_cur / 1024) + " kB";
  }
  return why + " (raise LimitMEMLOCK, or give CAP_IPC_LOCK)";
}

void limit_unplanned_stacks(std::size_t bytes) {
  pthread_attr_t attributes;
  if (pthread_getattr_default_np(&attributes) != 0) return;
  if (pthread_attr_setstacksize(&attributes, bytes) == 0) pthread_setattr_default_np(&attributes);
  pthread_attr_destroy(&attributes);
}

PageFaults thread_page_faults() {
  rusage use{};
  getrusage(RUSAGE_THREAD, &use);
  return {use.ru_minflt, use.ru_majflt};
}

}  // namespace godwit::rt
