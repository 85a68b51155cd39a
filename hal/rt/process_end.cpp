#include "hal/rt/process_end.h"

#include <algorithm>
#include <atomic>
#include <utility>

#include "hal/rt/wake_up.h"

namespace godwit::rt {
namespace {

/// What everybody is left, however late it is: a thread that ends needs a moment.
constexpr TimeNs kMomentNs = 100 * kNsPerMs;

/// Who wants the end -> who waits. Relaxed: a time alone, nothing is ordered by it.
std::atomic<TimeNs> end_ns{kNoEnd};

Abandon& word_of_program() {
  static Abandon abandon;
  return abandon;
}

}  // namespace

void begin_process_end() {
  TimeNs none = kNoEnd;
  end_ns.compare_exchange_strong(none, monotonic_now_ns() + kProcessEndNs, std::memory_order_relaxed);
}

TimeNs process_end_ns() {
  return end_ns.load(std::memory_order_relaxed);
}

TimeNs patience_left_ns(TimeNs patience_ns) {
  return std::max<TimeNs>(std::min(patience_ns, process_end_ns() - monotonic_now_ns()), 0);
}

TimeNs give_up_ns(TimeNs begin_ns, TimeNs patience_ns) {
  return std::max(std::min(begin_ns + patience_ns, process_end_ns()), begin_ns + kMomentNs);
}

void await_end(const std::function<bool()>& ended, const char* thread, TimeNs patience_ns, const Abandon& abandon) {
  const TimeNs begin_ns = monotonic_now_ns();
  while (abandon && !ended()) {
    // Asked anew each time: the end of the process may be wanted while somebody is waited for.
    if (monotonic_now_ns() > give_up_ns(begin_ns, patience_ns)) abandon(thread);
    sleep_until_ns(monotonic_now_ns() + kNsPerMs);
  }
}

void join_in_time(Thread* thread, TimeNs patience_ns, const Abandon& abandon) {
  if (!thread->running()) return;
  await_end([thread] { return thread->ended(); }, thread->name(), patience_ns, abandon);
  thread->join();
}

void join_as_it_works(Thread* thread, const std::function<std::uint64_t()>& done, TimeNs patience_ns,
                      const Abandon& abandon) {
  if (!thread->running()) return;
  std::uint64_t last = done();
  TimeNs since_ns = monotonic_now_ns();
  const auto ended = [&] {
    if (const std::uint64_t now = done(); now != last) {
      last = now;
      since_ns = monotonic_now_ns();
    }
    return thread->ended();
  };
  while (abandon && !ended()) {
    if (monotonic_now_ns() > give_up_ns(since_ns, patience_ns)) abandon(thread->name());
    sleep_until_ns(monotonic_now_ns() + kNsPerMs);
  }
  thread->join();
}

void abandon_threads_by(Abandon abandon) {
  word_of_program() = std::move(abandon);
}

void join_in_time(Thread* thread) {
  join_in_time(thread, kProcessEndNs, word_of_program());
}

void join_as_it_works(Thread* thread, const std::function<std::uint64_t()>& done, TimeNs patience_ns) {
  join_as_it_works(thread, done, patience_ns, word_of_program());
}

void forget_process_end() {
  end_ns.store(kNoEnd, std::memory_order_relaxed);
}

}  // namespace godwit::rt
