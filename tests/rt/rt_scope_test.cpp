#include "hal/rt/rt_scope.h"

#include <cstdlib>
#include <gtest/gtest.h>
#include <memory>
#include <thread>
#include <vector>

#include "hal/rt/alloc_hook.h"

namespace godwit::rt {
namespace {

TEST(RtScope, MarksItsOwnThreadOnlyAndNests) {
  EXPECT_FALSE(in_rt_scope());
  {
    const RtScope outer;
    EXPECT_TRUE(in_rt_scope());
    {
      const RtScope inner;
      EXPECT_TRUE(in_rt_scope());
    }
    EXPECT_TRUE(in_rt_scope()) << "the outer scope still stands";
    bool other = true;
    std::thread([&] { other = in_rt_scope(); }).join();
    EXPECT_FALSE(other);
  }
  EXPECT_FALSE(in_rt_scope());
}

// volatile: the compiler may otherwise leave out a pair of malloc and free whose memory nobody uses.
void* volatile sink;

TEST(AllocHook, CountsEveryWayToAllocateInsideAScopeOnly) {
  const HeapCounts before = rt_heap_counts();
  sink = std::malloc(10);
  std::free(sink);
  EXPECT_EQ(rt_heap_counts().allocations, before.allocations) << "outside a scope nothing counts";

  HeapCounts after_each[5];
  {
    const RtScope scope;
    sink = std::malloc(10);
    std::free(sink);
    after_each[0] = rt_heap_counts();
    sink = new int(3);
    delete static_cast<int*>(sink);
    after_each[1] = rt_heap_counts();
    void* p = nullptr;
    if (posix_memalign(&p, 64, 128) == 0) {
      sink = p;
      std::free(sink);
    }
    after_each[2] = rt_heap_counts();
    sink = std::aligned_alloc(64, 128);
    std::free(sink);
    after_each[3] = rt_heap_counts();
    std::vector<double> v(100);
    sink = v.data();
    after_each[4] = rt_heap_counts();
  }
  const std::uint64_t aligned = kAlignedAllocationsCounted ? 1 : 0;
  const std::uint64_t each[5] = {1, 1, aligned, aligned, 1};
  std::uint64_t expected = before.allocations;
  for (int i = 0; i < 5; ++i) {
    expected += each[i];
    EXPECT_EQ(after_each[i].allocations, expected) << "way " << i;
  }
  EXPECT_EQ(rt_heap_counts().frees - before.frees, 5u);
}

TEST(AllocHookDeathTest, TheTrapEndsADeliberateOffence) {
  EXPECT_DEATH(
      {
        trap_heap_use(true);
        sink = std::malloc(10);  // allowed: no scope
        const RtScope scope;
        sink = new int(3);
      },
      "memory was allocated on a real-time thread");
  EXPECT_DEATH(
      {
        trap_heap_use(true);
        sink = std::malloc(10);
        const RtScope scope;
        std::free(sink);
      },
      "memory was freed on a real-time thread");
}

}  // namespace
}  // namespace godwit::rt
