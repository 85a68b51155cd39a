#include "hal/rt/lock_hook.h"

#include <atomic>
#include <cstdlib>
#include <cstring>
#include <dlfcn.h>
#include <pthread.h>
#include <unistd.h>

#include "hal/rt/rt_scope.h"

namespace godwit::rt {
namespace {

constinit thread_local std::uint64_t lock_count = 0;
/// Set by the test's thread, read by every thread. Relaxed: it is set before the threads it is for are started.
constinit std::atomic<bool> trapped{false};

void note_lock() {
  if (!in_rt_scope()) return;
  ++lock_count;
  if (!trapped.load(std::memory_order_relaxed)) return;
  constexpr char kWords[] = "real-time trap: a mutex, condition or lock was used on a real-time thread\n";
  [[maybe_unused]] const auto ignored = write(STDERR_FILENO, kWords, std::strlen(kWords));
  std::abort();
}

/// glibc's own function of this name, looked up at the first call; a second thread that comes meanwhile finds the same.
template <typename Function>
Function* real(std::atomic<void*>* found, const char* name) {
  void* address = found->load(std::memory_order_relaxed);
  if (address == nullptr) {
    address = dlsym(RTLD_NEXT, name);
    if (address == nullptr) std::abort();
    found->store(address, std::memory_order_relaxed);
  }
  return reinterpret_cast<Function*>(address);
}

}  // namespace

std::uint64_t rt_lock_count() {
  return lock_count;
}

void trap_lock_use(bool on) {
  trapped.store(on, std::memory_order_relaxed);
}

}  // namespace godwit::rt

// Defining the public names in the program itself replaces them for every library in it.
#define GODWIT_HOOK(name, parameters, arguments)                      \
  int name parameters {                                               \
    static constinit std::atomic<void*> found{nullptr};               \
    godwit::rt::note_lock();                                          \
    return godwit::rt::real<int parameters>(&found, #name) arguments; \
  }

extern "C" {
GODWIT_HOOK(pthread_mutex_lock, (pthread_mutex_t * m) noexcept, (m))
GODWIT_HOOK(pthread_mutex_trylock, (pthread_mutex_t * m) noexcept, (m))
GODWIT_HOOK(pthread_mutex_timedlock, (pthread_mutex_t * m, const timespec* t) noexcept, (m, t))
GODWIT_HOOK(pthread_mutex_clocklock, (pthread_mutex_t * m, clockid_t c, const timespec* t) noexcept, (m, c, t))
GODWIT_HOOK(pthread_mutex_unlock, (pthread_mutex_t * m) noexcept, (m))
GODWIT_HOOK(pthread_rwlock_rdlock, (pthread_rwlock_t * l) noexcept, (l))
GODWIT_HOOK(pthread_rwlock_wrlock, (pthread_rwlock_t * l) noexcept, (l))
GODWIT_HOOK(pthread_rwlock_unlock, (pthread_rwlock_t * l) noexcept, (l))
GODWIT_HOOK(pthread_cond_wait, (pthread_cond_t * c, pthread_mutex_t* m), (c, m))
GODWIT_HOOK(pthread_cond_timedwait, (pthread_cond_t * c, pthread_mutex_t* m, const timespec* t), (c, m, t))
GODWIT_HOOK(pthread_cond_clockwait, (pthread_cond_t * c, pthread_mutex_t* m, clockid_t k, const timespec* t),
            (c, m, k, t))
GODWIT_HOOK(pthread_cond_signal, (pthread_cond_t * c) noexcept, (c))
GODWIT_HOOK(pthread_cond_broadcast, (pthread_cond_t * c) noexcept, (c))
}
