// What a camera thread may not do while it delivers.
#pragma once

#include <gtest/gtest.h>

#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#include "hal/rt/lock_hook.h"
#endif

namespace godwit::test {

/// deliver(i) for i below `pictures`, in a real-time scope: no heap and, where the sanitizers leave locks alone, no
/// lock.
template <typename Deliver>
void expect_no_heap_and_no_lock(int pictures, const Deliver& deliver) {
  const rt::HeapCounts before = rt::rt_heap_counts();
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
  const std::uint64_t locks = rt::rt_lock_count();
#endif
  for (int i = 0; i < pictures; ++i) {
    const rt::RtScope real_time;
    deliver(i);
  }
  EXPECT_EQ(rt::rt_heap_counts().allocations, before.allocations);
  EXPECT_EQ(rt::rt_heap_counts().frees, before.frees);
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
  EXPECT_EQ(rt::rt_lock_count(), locks);
#endif
}

}  // namespace godwit::test
