// A log whose reader is slow, stuck or gone.
#include "firmware_app/output/line_log.h"

#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstdlib>
#include <fcntl.h>
#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>
#include <pthread.h>
#include <string>
#include <sys/prctl.h>
#include <sys/ptrace.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>

#include "hal/rt/wake_up.h"

namespace godwit::app {
namespace {

struct Pipe {
  Pipe() { EXPECT_EQ(pipe(end), 0); }
  ~Pipe() {
    close_reader();
    close(end[1]);
  }
  void close_reader() {
    if (end[0] >= 0) close(end[0]);
    end[0] = -1;
  }
  std::string read_some() {
    std::string out(1 << 16, '\0');
    const ssize_t n = read(end[0], out.data(), out.size());
    out.resize(n > 0 ? static_cast<std::size_t>(n) : 0);
    return out;
  }
  int end[2] = {-1, -1};
};

/// A thread of this process that a debugger holds, as long as this lives.
class HeldThread {
 public:
  explicit HeldThread(pid_t thread) {
    int ends[2] = {};
    if (pipe(ends) != 0) return;
    child_ = fork();
    if (child_ == 0) {
      char go = 0;
      if (read(ends[0], &go, 1) != 1) _exit(1);
      const bool held = ptrace(PTRACE_SEIZE, thread, nullptr, nullptr) == 0 &&
                        ptrace(PTRACE_INTERRUPT, thread, nullptr, nullptr) == 0 &&
                        waitpid(thread, nullptr, __WALL) == thread;
      if (!held) _exit(1);
      kill(getpid(), SIGSTOP);  // tells who waits for it
      _exit(0);
    }
    prctl(PR_SET_PTRACER, child_, 0, 0, 0);
    if (write(ends[1], "x", 1) != 1) return;
    close(ends[0]);
    close(ends[1]);
    int status = 0;
    held_ = waitpid(child_, &status, WUNTRACED) == child_ && WIFSTOPPED(status);
    if (!held_) child_ = -1;
  }
  ~HeldThread() { release(); }
  HeldThread(const HeldThread&) = delete;
  HeldThread& operator=(const HeldThread&) = delete;
  void release() {
    if (child_ < 0) return;
    kill(child_, SIGKILL);
    waitpid(child_, nullptr, 0);
    child_ = -1;
  }
  bool held() const { return held_; }

 private:
  pid_t child_ = -1;
  bool held_ = false;
};

/// The newest thread of this name; 0: there is none.
pid_t newest_thread(const std::string& name) {
  pid_t newest = 0;
  for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
    std::string said;
    std::getline(std::ifstream(task.path() / "comm"), said);
    if (said == name) newest = std::max(newest, static_cast<pid_t>(std::stoi(task.path().filename())));
  }
  return newest;
}

TEST(LineLog, LinesComeWholeAndInOrder) {
  Pipe pipe;
  LineLog log(pipe.end[1]);
  for (int i = 0; i < 100; ++i) log.put("line " + std::to_string(i));
  ASSERT_TRUE(log.flush(10 * rt::kNsPerSecond));
  std::string expected;
  for (int i = 0; i < 100; ++i) expected += "line " + std::to_string(i) + "\n";
  EXPECT_EQ(pipe.read_some(), expected);
  EXPECT_EQ(log.lost(), 0u);
}

TEST(LineLog, AStuckReaderCostsLinesAndNobodyWaits) {
  Pipe pipe;
  fcntl(pipe.end[1], F_SETPIPE_SZ, 4096);
  LineLog log(pipe.end[1]);
  const std::string line(200, 'x');
  for (int i = 0; i < 3000; ++i) log.put(line);  // would hang here
  EXPECT_FALSE(log.flush(rt::kNsPerMs));
  EXPECT_GE(log.lost(), 1900u);
  // Read again: the rest comes, and how many were lost.
  std::string said;
  while (!log.flush(rt::kNsPerMs)) said += pipe.read_some();
  log.put("after");
  ASSERT_TRUE(log.flush(10 * rt::kNsPerSecond));
  said += pipe.read_some();
  EXPECT_NE(said.find(" lines of the log were lost before this one\n"), std::string::npos);
  EXPECT_NE(said.find("after\n"), std::string::npos);
}

TEST(LineLog, AReaderThatIsGoneIsNoEnd) {
  std::signal(SIGPIPE, SIG_IGN);
  Pipe pipe;
  LineLog log(pipe.end[1]);
  pipe.close_reader();
  for (int i = 0; i < 10; ++i) log.put("nobody hears this");
  EXPECT_TRUE(log.flush(10 * rt::kNsPerSecond));
  EXPECT_EQ(log.lost(), 10u);
}

#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)  // their own memory would fall under the limit
TEST(LineLog, WithoutAThreadLinesAreLostAndSignalsStillHeard) {
  const auto without_room_for_a_stack = [] {
    const rlimit none{1, RLIM_INFINITY};
    setrlimit(RLIMIT_AS, &none);
    LineLog log(STDERR_FILENO);
    log.put("lost");
    sigset_t blocked;
    pthread_sigmask(SIG_SETMASK, nullptr, &blocked);
    _exit(log.lost() != 1 ? 2 : sigismember(&blocked, SIGTERM) != 0 ? 3 : 0);
  };
  // In a process of its own: this one keeps the stacks of earlier threads for new ones.
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(without_room_for_a_stack(), ::testing::ExitedWithCode(0), "");
}
#endif

// The writing thread hangs while the log is taken down; for the sanitizers.
TEST(LineLog, AHangingWriterIsLeftBehind) {
  Pipe pipe;
  fcntl(pipe.end[1], F_SETPIPE_SZ, 4096);
  {
    LineLog log(pipe.end[1]);
    for (int i = 0; i < 100; ++i) log.put(std::string(200, 'x'));
    EXPECT_FALSE(log.flush(rt::kNsPerMs));
  }
  // Lets it run to its end before the pipe goes.
  fcntl(pipe.end[0], F_SETFL, O_NONBLOCK);
  for (int i = 0; i < 50; ++i) {
    pipe.read_some();
    rt::sleep_until_ns(rt::monotonic_now_ns() + rt::kNsPerMs);
  }
}

// On a condition variable they would: its signal waits until a waiter that was woken before has left it.
TEST(LineLog, AWriterThatStandsWherePeopleWaitHoldsNobodyUp) {
  Pipe pipe;
  LineLog log(pipe.end[1]);
  log.put("before");
  ASSERT_TRUE(log.flush(10 * rt::kNsPerSecond));
  rt::sleep_until_ns(rt::monotonic_now_ns() + 100 * rt::kNsPerMs);  // it waits for the next line by now
  HeldThread writer(newest_thread("gw-log"));
  if (!writer.held()) {
    const char* ci = std::getenv("CI");
    if (ci != nullptr && std::string(ci) == "true") FAIL() << "no thread can be held here";
    GTEST_SKIP() << "no thread can be held here";
  }
  log.put("wakes it, but it stands");
  const rt::TimeNs begin_ns = rt::monotonic_now_ns();
  std::thread end([&] { EXPECT_FALSE(log.flush(rt::kNsPerSecond)); });
  rt::sleep_until_ns(begin_ns + 200 * rt::kNsPerMs);
  std::thread another([&] { log.put("another"); });
  std::atomic<bool> over{false};
  std::thread at_last([&] {
    while (!over.load() && rt::monotonic_now_ns() < begin_ns + 20 * rt::kNsPerSecond) {
      rt::sleep_until_ns(rt::monotonic_now_ns() + 10 * rt::kNsPerMs);
    }
    writer.release();
  });
  another.join();
  end.join();
  const rt::TimeNs took_ns = rt::monotonic_now_ns() - begin_ns;
  over.store(true);
  at_last.join();
  EXPECT_LT(took_ns, 15 * rt::kNsPerSecond);
  EXPECT_TRUE(log.flush(10 * rt::kNsPerSecond));
  EXPECT_EQ(log.lost(), 0u);
}

}  // namespace
}  // namespace godwit::app
