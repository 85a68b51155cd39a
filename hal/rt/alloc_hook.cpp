#include "hal/rt/alloc_hook.h"

#include <cerrno>
#include <cstddef>

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

void note_allocation() {
  if (in_rt_scope()) ++counts.allocations;
}
void note_free() {
  if (in_rt_scope()) ++counts.frees;
}
}  // namespace

HeapCounts rt_heap_counts() {
  return counts;
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
