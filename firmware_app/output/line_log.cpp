#include "firmware_app/output/line_log.h"

#include <atomic>
#include <cerrno>
#include <chrono>
#include <condition_variable>
#include <csignal>
#include <cstdio>
#include <deque>
#include <mutex>
#include <poll.h>
#include <pthread.h>
#include <string_view>
#include <thread>
#include <unistd.h>

namespace godwit::app {
namespace {
constexpr std::size_t kMostLines = 1000;
/// A stream set not to block is tried again so often.
constexpr int kRetryMs = 100;
}  // namespace

struct LineLog::State {
  explicit State(int descriptor) : fd(descriptor) {}
  const int fd;
  std::mutex mutex;
  std::condition_variable change;  // lines came, or were written, or it ends
  std::deque<std::string> lines;
  std::atomic<std::uint64_t> lost{0};  // also counted where the mutex cannot be had; a number alone
  std::uint64_t told_lost = 0;
  bool writing = false;
  bool ending = false;
  bool has_thread = false;

  /// False: the stream failed.
  bool write_all(std::string_view text) {
    std::size_t done = 0;
    while (done < text.size()) {
      const ssize_t n = ::write(fd, text.data() + done, text.size() - done);
      if (n > 0) {
        done += static_cast<std::size_t>(n);
      } else if (n < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) {
        pollfd room{fd, POLLOUT, 0};
        poll(&room, 1, kRetryMs);
        const std::lock_guard<std::mutex> lock(mutex);
        if (ending) return false;
      } else if (n == 0 || errno != EINTR) {
        return false;
      }
    }
    return true;
  }

  void run() {
    std::unique_lock<std::mutex> lock(mutex);
    while (true) {
      change.wait(lock, [this] { return ending || !lines.empty(); });
      if (lines.empty()) return;
      // Nothing here allocates: what is thrown on this thread ends the process.
      const std::string text = std::move(lines.front());
      lines.pop_front();
      const std::uint64_t lost_now = lost;
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
        ++lost;
      }
      change.notify_all();
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
  try {
    const std::lock_guard<std::mutex> lock(state_->mutex);
    state_->ending = true;
    state_->change.notify_all();
  } catch (const std::exception&) {
  }
}

void LineLog::put(std::string line) noexcept {
  try {
    line += '\n';
    const std::lock_guard<std::mutex> lock(state_->mutex);
    if (!state_->has_thread || state_->lines.size() >= kMostLines) {
      ++state_->lost;
      return;
    }
    state_->lines.push_back(std::move(line));
    state_->change.notify_all();
  } catch (const std::exception&) {
    ++state_->lost;  // no memory
  }
}

bool LineLog::flush(rt::TimeNs patience_ns) noexcept {
  try {
    std::unique_lock<std::mutex> lock(state_->mutex);
    return state_->change.wait_for(lock, std::chrono::nanoseconds(patience_ns),
                                   [this] { return state_->lines.empty() && !state_->writing; });
  } catch (const std::exception&) {
    return false;
  }
}

std::uint64_t LineLog::lost() const noexcept {
  try {
    const std::lock_guard<std::mutex> lock(state_->mutex);
    return state_->lost;
  } catch (const std::exception&) {
    return 0;
  }
}

LineLog& error_log() {
  // Never destroyed: threads may say something until the very end.
  static LineLog* const log = new LineLog(STDERR_FILENO);
  return *log;
}

}  // namespace godwit::app
