#include "hal/rt/thread.h"

#include <cstring>
#include <gtest/gtest.h>
#include <sched.h>

#include "hal/rt/memory.h"

namespace godwit::rt {
namespace {

TEST(Thread, RunsWithItsNameOnItsProcessorsAndItsStack) {
  Thread thread;
  char name[32] = {};
  cpu_set_t set;
  CPU_ZERO(&set);
  ASSERT_TRUE(thread
                  .start("gw-a-very-long-name", {{0}, 0},
                         [&] {
                           pthread_getname_np(pthread_self(), name, sizeof(name));
                           sched_getaffinity(0, sizeof(set), &set);
                         })
                  .ok());
  thread.join();
  EXPECT_EQ(thread.warning(), "");
  EXPECT_STREQ(name, "gw-a-very-long-") << "the kernel keeps 15 bytes";
  EXPECT_EQ(CPU_COUNT(&set), 1);
  EXPECT_GT(thread.stack_used(), 0u);
  EXPECT_LT(thread.stack_used(), kThreadStackBytes);
}

/// Touches `bytes` of the stack.
void dig(std::size_t bytes) {
  volatile char* const hole = static_cast<volatile char*>(__builtin_alloca(bytes));
  for (std::size_t i = 0; i < bytes; ++i) hole[i] = 1;
}

TEST(Thread, KnowsHowDeepItsStackWasUsedAndFaultsNoPageThere) {
  Thread thread;
  PageFaults faults;
  ASSERT_TRUE(thread
                  .start("gw-dig", {},
                         [&] {
                           dig(4096);
                           const PageFaults before = thread_page_faults();
                           dig(300 * 1024);
                           faults = thread_page_faults() - before;
                         })
                  .ok());
  thread.join();
  EXPECT_GT(thread.stack_used(), 300u * 1024);
#ifndef GODWIT_OTHERS_FAULT
  // A page or two may be the measuring's own; untouched it would be 75.
  EXPECT_LT(faults.minor, 8);
#endif
  EXPECT_EQ(faults.major, 0);
}

TEST(Thread, MayBeStartedAgain) {
  Thread thread;
  int runs = 0;
  for (int i = 0; i < 3; ++i) {
    ASSERT_TRUE(thread.start("gw-again", {}, [&] { ++runs; }).ok());
    thread.join();
  }
  EXPECT_EQ(runs, 3);
}

TEST(Thread, WhatTheMachineRefusesIsToldAndTheThreadRuns) {
  Thread thread;
  bool ran = false;
  ASSERT_TRUE(thread.start("gw-odd", {{CPU_SETSIZE - 1}, 1000}, [&] { ran = true; }).ok());
  thread.join();
  EXPECT_TRUE(ran);
  EXPECT_EQ(thread.warning(), "gw-odd: processors 1023: Invalid argument; SCHED_FIFO priority 1000: Invalid argument");
}

TEST(PageFaults, AreCountedForTheThreadThatHasThem) {
  const PageFaults before = thread_page_faults();
  constexpr std::size_t kBytes = 64 * 4096;
  void* const memory = std::aligned_alloc(4096, kBytes);
  std::memset(memory, 1, kBytes);
  static_cast<void>(*static_cast<volatile char*>(memory));
  std::free(memory);
  EXPECT_GT((thread_page_faults() - before).minor, 0);
}

}  // namespace
}  // namespace godwit::rt
