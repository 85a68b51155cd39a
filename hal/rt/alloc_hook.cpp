#include "hal/rt/alloc_hook.h"

#include <atomic>
#include <cerrno>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <unistd.h>

#include "hal/rt/rt_scope.h"

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define GODWIT_SANITIZER_HEAP 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define GODWIT_SANITIZER_HEAP 1
#endif
#endif

namespace godwit::rt {
namespace {
constinit thread_local HeapCounts counts;

/// Set by the test's thread, read by every thread. Relaxed: it is set before the threads it is for are started.
constinit std::atomic<bool> trapped{false};

void offence(const char* words) {
  if (!trapped.load(std::memory_order_relaxed)) return;
  // write, not printf: the offender may hold whatever lock printf wants.
  [[maybe_unused]] const auto ignored = write(STDERR_FILENO, words, std::strlen(words));
  std::abort();
}

void note_allocation() {
  if (!in_rt_scope()) return;
  ++counts.allocations;
  offence("real-time trap: memory was allocated on a real-time thread\n");
}
void note_free() {
  if (!in_rt_scope()) return;
  ++counts.frees;
  offence("real-time trap: memory was freed on a real-time thread\n");
}
}  // namespace

HeapCounts rt_heap_counts() {
  return counts;
}

void trap_heap_use(bool on) {
  trapped.store(on, std::memory_order_relaxed);
}

#ifdef GODWIT_SANITIZER_HEAP
}  // namespace godwit::rt

// The sanitizers own malloc; they offer this hook instead (sanitizer/allocator_interface.h).
extern "C" int __sanitizer_install_malloc_and_free_hooks(void (*on_malloc)(const volatile void*, std::size_t),
                                                         void (*on_free)(const volatile void*));

namespace godwit::rt {
namespace {
const int hooks_installed =
    __sanitizer_install_malloc_and_free_hooks([](const volatile void*, std::size_t) { note_allocation(); },
                                              [](const volatile void* address) {
                                                if (address != nullptr) note_free();
                                              });
}  // namespace
}  // namespace godwit::rt

#else
}  // namespace godwit::rt

// glibc's own entry points; defining the public names in the program itself replaces them for every library in it.
extern "C" {
void* __libc_malloc(std::size_t size);
void* __libc_calloc(std::size_t count, std::size_t size);
void* __libc_realloc(void* address, std::size_t size);
void* __libc_memalign(std::size_t alignment, std::size_t size);
void __libc_free(void* address);

void* malloc(std::size_t size) {
  godwit::rt::note_allocation();
  return __libc_malloc(size);
}
void* calloc(std::size_t count, std::size_t size) {
  godwit::rt::note_allocation();
  return __libc_calloc(count, size);
}
void* realloc(void* address, std::size_t size) {
  godwit::rt::note_allocation();
  return __libc_realloc(address, size);
}
void* memalign(std::size_t alignment, std::size_t size) {
  godwit::rt::note_allocation();
  return __libc_memalign(alignment, size);
}
void* aligned_alloc(std::size_t alignment, std::size_t size) {
  godwit::rt::note_allocation();
  return __libc_memalign(alignment, size);
}
int posix_memalign(void** address, std::size_t alignment, std::size_t size) {
  godwit::rt::note_allocation();
  void* const p = __libc_memalign(alignment, size);
  if (p == nullptr) return ENOMEM;
  *address = p;
  return 0;
}
void free(void* address) {
  if (address != nullptr) godwit::rt::note_free();
  __libc_free(address);
}
}
#endif
