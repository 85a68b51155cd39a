// Counts the mutex, condition and reader-writer-lock operations of a thread while it is marked real-time
// (hal/rt/rt_scope.h). For tests: link the library godwit_rt_lock_hook, whose object replaces pthread's functions;
// std::mutex and its kin come through them. Semaphores are not among them: a WakeUp is how a thread sleeps between two
// frames.
#pragma once

#include <cstdint>

namespace godwit::rt {

/// Lock operations of the calling thread inside RtScopes since it started. No allocation, no lock.
std::uint64_t rt_lock_count();

/// On: such an operation, on whichever thread, ends the process at once with words on the error stream.
void trap_lock_use(bool on);

}  // namespace godwit::rt
