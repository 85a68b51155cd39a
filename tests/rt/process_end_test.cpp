#include "hal/rt/process_end.h"

#include <atomic>
#include <gtest/gtest.h>
#include <string>
#include <unistd.h>
#include <vector>

#include "hal/rt/wake_up.h"

namespace godwit::rt {
namespace {

class ProcessEnd : public ::testing::Test {
 protected:
  void TearDown() override {
    forget_process_end();
    abandon_threads_by(nullptr);
  }
  /// A program would end where it abandons; here what hangs is let go.
  Abandon abandon() {
    return [this](const char* thread) {
      // Asked again until it has ended.
      if (abandoned_.empty() || abandoned_.back() != thread) abandoned_.emplace_back(thread);
      hangs_.store(false);
    };
  }
  void start_hanging(const char* name) {
    hangs_.store(true);
    ASSERT_TRUE(thread_.start(name, {}, [this] {
      while (hangs_.load()) sleep_until_ns(monotonic_now_ns() + kNsPerMs);
    }));
  }

  std::atomic<bool> hangs_{false};
  std::vector<std::string> abandoned_;
  Thread thread_;
};

TEST_F(ProcessEnd, AllWaitForOneMoment) {
  EXPECT_EQ(patience_left_ns(kNsPerSecond), kNsPerSecond);
  begin_process_end();
  const TimeNs end_ns = process_end_ns();
  sleep_until_ns(monotonic_now_ns() + 20 * kNsPerMs);
  begin_process_end();
  EXPECT_EQ(process_end_ns(), end_ns) << "the first that wants the end counts";
  EXPECT_LE(patience_left_ns(60 * kNsPerSecond), kProcessEndNs - 20 * kNsPerMs);
  alarm(60);  // one that waits for its own hour fails, and is not waited for
  for (const char* const name : {"gw-first", "gw-second", "gw-third"}) {
    start_hanging(name);
    join_in_time(&thread_, 3600 * kNsPerSecond, abandon());
    EXPECT_GE(monotonic_now_ns(), end_ns) << "all of the time is theirs";
  }
  alarm(0);
  EXPECT_EQ(patience_left_ns(60 * kNsPerSecond), 0);
  EXPECT_EQ(abandoned_, (std::vector<std::string>{"gw-first", "gw-second", "gw-third"}));
}

TEST_F(ProcessEnd, WhoIsWaitedForIsNotLeftBehindBeforeItsTime) {
  start_hanging("gw-slow");
  std::atomic<bool> told{false};
  Thread other;
  ASSERT_TRUE(other.start("other", {}, [&] {
    while (!told.load()) sleep_until_ns(monotonic_now_ns() + kNsPerMs);
    sleep_until_ns(monotonic_now_ns() + 50 * kNsPerMs);
    hangs_.store(false);
  }));
  told.store(true);
  join_in_time(&thread_, 60 * kNsPerSecond, abandon());
  other.join();
  EXPECT_TRUE(abandoned_.empty());
  EXPECT_FALSE(thread_.running());
}

// A recording's writers at a slow card: 128 pictures wait, and took longer than any thread's end was waited for.
TEST_F(ProcessEnd, WhoGetsSomethingDoneIsWaitedForLongerThanItsPatience) {
  std::atomic<std::uint64_t> done{0};
  ASSERT_TRUE(thread_.start("gw-slow", {}, [&] {
    for (; done < 40; ++done) sleep_until_ns(monotonic_now_ns() + 50 * kNsPerMs);
  }));
  join_as_it_works(
      &thread_, [&] { return done.load(); }, kNsPerSecond, abandon());
  EXPECT_TRUE(abandoned_.empty());
  EXPECT_EQ(done, 40u);
  start_hanging("gw-stands");
  const TimeNs begin_ns = monotonic_now_ns();
  join_as_it_works(
      &thread_, [&] { return done.load(); }, 100 * kNsPerMs, abandon());
  EXPECT_EQ(abandoned_, std::vector<std::string>{"gw-stands"});
  EXPECT_GE(monotonic_now_ns() - begin_ns, 100 * kNsPerMs);
}

TEST_F(ProcessEnd, AThreadOfWhichNobodyIsToldIsForTheProgramsWord) {
  abandon_threads_by(abandon());
  begin_process_end();
  start_hanging("gw-device");
  join_in_time(&thread_);
  EXPECT_EQ(abandoned_, std::vector<std::string>{"gw-device"});
}

TEST_F(ProcessEnd, WithoutAWordItIsWaitedFor) {
  Thread other;
  start_hanging("gw-device");
  ASSERT_TRUE(other.start("other", {}, [this] {
    sleep_until_ns(monotonic_now_ns() + 50 * kNsPerMs);
    hangs_.store(false);
  }));
  join_in_time(&thread_);
  other.join();
  EXPECT_FALSE(thread_.running());
}

}  // namespace
}  // namespace godwit::rt
