#include "hal/rt/lock_hook.h"

#include <chrono>
#include <condition_variable>
#include <gtest/gtest.h>
#include <mutex>
#include <shared_mutex>

#include "hal/rt/rt_scope.h"
#include "hal/rt/wake_up.h"

namespace godwit::rt {
namespace {

TEST(LockHook, CountsInsideAScopeOnly) {
  std::mutex mutex;
  const std::uint64_t before = rt_lock_count();
  { const std::lock_guard<std::mutex> held(mutex); }
  EXPECT_EQ(rt_lock_count(), before);
  {
    const RtScope scope;
    const std::lock_guard<std::mutex> held(mutex);
  }
  EXPECT_EQ(rt_lock_count() - before, 2u) << "lock and unlock";
}

TEST(LockHook, CountsEveryKindOfLock) {
  std::mutex mutex;
  std::timed_mutex timed;
  std::shared_mutex shared;
  std::condition_variable condition;
  std::uint64_t counts[6] = {};
  {
    const RtScope scope;
    counts[0] = rt_lock_count();
    if (mutex.try_lock()) mutex.unlock();
    counts[1] = rt_lock_count();
    if (timed.try_lock_for(std::chrono::milliseconds(1))) timed.unlock();
    counts[2] = rt_lock_count();
    shared.lock_shared();
    shared.unlock_shared();
    counts[3] = rt_lock_count();
    shared.lock();
    shared.unlock();
    counts[4] = rt_lock_count();
    condition.notify_all();
    counts[5] = rt_lock_count();
  }
  for (int i = 0; i < 5; ++i) EXPECT_GT(counts[i + 1], counts[i]) << "way " << i;
}

TEST(LockHook, AWakeUpIsNoLock) {
  WakeUp wake;
  const std::uint64_t before = rt_lock_count();
  {
    const RtScope scope;
    wake.post();
    EXPECT_TRUE(wake.wait_for(kNsPerSecond));
    EXPECT_FALSE(wake.wait_for(kNsPerMs));
  }
  EXPECT_EQ(rt_lock_count(), before);
}

TEST(LockHookDeathTest, TheTrapEndsADeliberateOffence) {
  EXPECT_DEATH(
      {
        trap_lock_use(true);
        std::mutex mutex;
        mutex.lock();  // allowed: no scope
        mutex.unlock();
        const RtScope scope;
        mutex.lock();
      },
      "a mutex, condition or lock was used on a real-time thread");
}

}  // namespace
}  // namespace godwit::rt
