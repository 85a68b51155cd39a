// "From here on this thread is real-time": the mark that allocation counters and traps look at.
#pragma once

#include <cstdint>

namespace godwit::rt {

/// Marks the calling thread as real-time for its own lifetime. Scopes nest. No allocation, no lock.
/// The mark alone changes nothing: hooks (hal/rt/alloc_hook.h in tests, traps of the real-time audit) ask for it.
class RtScope {
 public:
  RtScope();
  ~RtScope();
  RtScope(const RtScope&) = delete;
  RtScope& operator=(const RtScope&) = delete;
};

/// The calling thread is inside an RtScope.
bool in_rt_scope();

}  // namespace godwit::rt
