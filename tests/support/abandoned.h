// Who is left behind at an end by the program's word (hal/rt/process_end.h).
#pragma once

#include <functional>
#include <string>

#include "hal/rt/process_end.h"
#include "hal/rt/wake_up.h"
#include "tests/support/standing_thread.h"

namespace godwit::test {

/// Calls end(), which waits for a thread that hangs; what hangs is let go when it is abandoned, where a program would
/// end, or after 20 s, where nobody does. The name that was said; empty: none.
inline std::string abandoned_by(const std::function<void()>& end, const std::function<void()>& let_go) {
  std::string abandoned;
  rt::abandon_threads_by([&](const char* thread) {
    abandoned = thread;
    let_go();
  });
  std::atomic<bool> over{false};
  rt::Thread at_last;
  const auto started = at_last.start("at-last", {}, [&] {
    const rt::TimeNs give_up_ns = rt::monotonic_now_ns() + 20 * rt::kNsPerSecond;
    while (!over.load() && rt::monotonic_now_ns() < give_up_ns) {
      rt::sleep_until_ns(rt::monotonic_now_ns() + 10 * rt::kNsPerMs);
    }
    let_go();
  });
  EXPECT_TRUE(started.ok());
  end();
  over.store(true);
  at_last.join();
  rt::abandon_threads_by(nullptr);
  return abandoned;
}

/// The same, while the thread of this name stands.
inline std::string abandoned_while_stands(const std::string& thread, const std::function<void()>& end) {
  // A thread gets its name a moment after it was started.
  rt::sleep_until_ns(rt::monotonic_now_ns() + 200 * rt::kNsPerMs);
  stop_thread(thread);
  rt::sleep_until_ns(rt::monotonic_now_ns() + 200 * rt::kNsPerMs);
  return abandoned_by(end, let_thread_go);
}

}  // namespace godwit::test
