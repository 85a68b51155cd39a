#include "firmware_app/output/line_log.h"

#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <deque>
#include <mutex>
#include <poll.h>
#include <pthread.h>
#include <string_view>
#include <thread>
#include <unistd.h>

#include "hal/rt/wake_up.h"

namespace godwit::app {
namespace {
constexpr std::size_t kMostLines = 1000;
/// A stream set not to block is tried again so often.
constexpr int kRetryMs = 100;
/// Longest sleep of the writer; only a safety net, every line is followed by a wake-up call.
constexpr rt::TimeNs kSleepNs = rt::kNsPerSecond;
/// Who holds the lines does so for a moment. One who stands meanwhile costs the others no more than this.
constexpr rt::TimeNs kLockPatienceNs = 100 * rt::kNsPerMs;
constexpr rt::TimeNs kLookNs = rt::kNsPerMs;

/// Tried for kLockPatienceNs; owns_lock() says whether it was had. A plain lock would wait for whoever stands with it,
/// and so does a condition variable, on whose signal a waiter that was woken before must first have left it.
std::unique_lock<std::mutex> lock_in_time(std::mutex* mutex) {
  std::unique_lock<std::mutex> lock(*mutex, std::try_to_lock);
  const rt::TimeNs give_up_ns = rt::monotonic_now_ns() + kLockPatienceNs;
  while (!lock.owns_lock() && rt::monotonic_now_ns() < give_up_ns) {
    rt::sleep_until_ns(rt::monotonic_now_ns() + kLookNs / 10);
    static_cast<void>(lock.try_lock());
  }
  return lock;
}
}  // namespace

struct LineLog::State {
  explicit State(int descriptor) : fd(descriptor) {}
  const int fd;
  std::mutex mutex;
  std::deque<std::string> lines;  // under mutex
  bool writing = false;           // under mutex
  bool has_thread = false;        // before anybody else knows of this
  rt::WakeUp wake;                // lines came, or it ends
  // Numbers and a flag alone; nothing is ordered by them.
  std::atomic<std::uint64_t> lost{0};
  std::atomic<bool> ending{false};
  std::uint64_t told_lost = 0;  // the thread's own

  /// False: the stream failed.
  bool write_all(std::string_view text) const {
    std::size_t done = 0;
    while (done < text.size()) {
      const ssize_t n = ::write(fd, text.data() + done, text.size() - done);
      if (n > 0) {
        done += n;
      } else if (n < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) {
        pollfd room{fd, POLLOUT, 0};
        poll(&room, 1, kRetryMs);
        if (ending.load(std::memory_order_relaxed)) return false;
      } else if (n == 0 || errno != EINTR) {
        return false;
      }
    }
    return true;
  }

  void run() {
    std::unique_lock<std::mutex> lock(mutex);
    while (true) {
      while (lines.empty()) {
        if (ending.load(std::memory_order_relaxed)) return;
        lock.unlock();
        wake.wait_for(kSleepNs);
        lock.lock();
      }
      // Nothing here allocates: what is thrown on this thread ends the process.
      const std::string text = std::move(lines.front());
      lines.pop_front();
      const std::uint64_t lost_now = lost.load(std::memory_order_relaxed);
      char notice[96] = "";
      if (lost_now != told_lost) {
        std::snprintf(notice, sizeof notice, "%llu lines of the log were lost before this one\n",
                      static_cast<unsigned long long>(lost_now - told_lost));
      }
      writing = true;
      lock.unlock();
      const bool written = write_all(notice) && write_all(text);
      lock.lock();
      writing = false;
      if (written) {
        told_lost = lost_now;
      } else {
        lost.fetch_add(1, std::memory_order_relaxed);
      }
    }
  }
};

LineLog::LineLog(int fd) : state_(std::make_shared<State>(fd)) {
  // Signals are the other threads' business.
  sigset_t all, before;
  sigfillset(&all);
  pthread_sigmask(SIG_SETMASK, &all, &before);
  try {
    std::thread([state = state_] {
      pthread_setname_np(pthread_self(), "gw-log");
      state->run();
    }).detach();
    state_->has_thread = true;
  } catch (const std::exception&) {
    // No thread to be had: every line is counted as lost.
  }
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
}

LineLog::~LineLog() {
  state_->ending.store(true, std::memory_order_relaxed);
  state_->wake.post();
}

void LineLog::put(std::string line) noexcept {
  try {
    line += '\n';
    const auto lock = lock_in_time(&state_->mutex);
    if (lock.owns_lock() && state_->has_thread && state_->lines.size() < kMostLines) {
      state_->lines.push_back(std::move(line));
      state_->wake.post();
      return;
    }
  } catch (const std::exception&) {  // no memory
  }
  state_->lost.fetch_add(1, std::memory_order_relaxed);
}

bool LineLog::flush(rt::TimeNs patience_ns) noexcept {
  const rt::TimeNs give_up_ns = rt::monotonic_now_ns() + patience_ns;
  while (true) {
    try {
      const auto lock = lock_in_time(&state_->mutex);
      if (lock.owns_lock() && state_->lines.empty() && !state_->writing) return true;
    } catch (const std::exception&) {
    }
    if (rt::monotonic_now_ns() >= give_up_ns) return false;
    rt::sleep_until_ns(rt::monotonic_now_ns() + kLookNs);
  }
}

std::uint64_t LineLog::lost() const noexcept {
  return state_->lost.load(std::memory_order_relaxed);
}

LineLog& error_log() {
  // Never destroyed: threads may say something until the very end.
  static LineLog* const log = new LineLog(STDERR_FILENO);
  return *log;
}

}  // namespace godwit::app
