// Counts what a thread allocates and frees while it is marked real-time (hal/rt/rt_scope.h). For tests: link the
// library godwit_rt_alloc_hook, whose object replaces malloc and its kin (under sanitizers it hangs on their own
// hooks).
#pragma once

#include <cstdint>

namespace godwit::rt {

/// The thread sanitizer does not report posix_memalign and aligned_alloc to its hooks: under it they go uncounted.
#if defined(__SANITIZE_THREAD__)
constexpr bool kAlignedAllocationsCounted = false;
#else
constexpr bool kAlignedAllocationsCounted = true;
#endif

/// Heap operations of the calling thread inside RtScopes since it started.
struct HeapCounts {
  std::uint64_t allocations = 0;  ///< malloc, calloc, realloc, aligned ones; operator new comes through them
  std::uint64_t frees = 0;
};

/// Of the calling thread. No allocation, no lock.
HeapCounts rt_heap_counts();

/// On: a heap operation inside an RtScope, on whichever thread, ends the process at once with words on the error
/// stream, so that a debugger or core file shows the offender. Counts go on.
void trap_heap_use(bool on);

}  // namespace godwit::rt
