#include "hal/rt/rt_scope.h"

#include <cassert>

namespace godwit::rt {
namespace {
// constinit: no guard variable and no lazy initialisation, because an allocator hook may ask before main.
constinit thread_local int scope_depth = 0;
}  // namespace

RtScope::RtScope() {
  ++scope_depth;
}

RtScope::~RtScope() {
  assert(scope_depth > 0);
  --scope_depth;
}

bool in_rt_scope() {
  return scope_depth > 0;
}

}  // namespace godwit::rt
