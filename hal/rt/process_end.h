// The end of a process, which a thread that hangs must not keep away: one moment for all that is waited for.
#pragma once

#include <cstdint>
#include <functional>

#include "hal/rt/thread.h"
#include "hal/rt/time.h"

namespace godwit::rt {

/// After so long at the end of the process what still stands is left behind. systemd waits five seconds
/// (systemd/godwitd.service.in); the log wants the rest.
constexpr TimeNs kProcessEndNs = 3 * kNsPerSecond;

/// The process is to end: its time runs from now on. The first call counts. Any thread, no wait.
void begin_process_end();
/// The moment at which nobody is waited for any more, of CLOCK_MONOTONIC; kNoEnd before begin_process_end().
constexpr TimeNs kNoEnd = INT64_MAX;
TimeNs process_end_ns();
/// patience_ns, or less where the process's end comes before; not below 0.
TimeNs patience_left_ns(TimeNs patience_ns);
/// Until when somebody is waited for whose end was wanted at begin_ns: for patience_ns, or until the process's end
/// where that comes before; who comes to be waited for late still has a moment.
TimeNs give_up_ns(TimeNs begin_ns, TimeNs patience_ns);

/// Called with a thread's name where it does not end in time; must not return.
using Abandon = std::function<void(const char* thread)>;

/// Waits until ended() holds, and from give_up_ns() on calls abandon. Null: returns at once, the join that follows
/// waits.
void await_end(const std::function<bool()>& ended, const char* thread, TimeNs patience_ns, const Abandon& abandon);

/// Joins a thread that was told to end, if it runs; waits as await_end() does.
void join_in_time(Thread* thread, TimeNs patience_ns, const Abandon& abandon);

/// The same for one that has work left: its patience counts from the last time done() grew, whose thread this may be.
void join_as_it_works(Thread* thread, const std::function<std::uint64_t()>& done, TimeNs patience_ns,
                      const Abandon& abandon);

/// The program's word for threads of which nobody else is told: those of devices. Before any of them starts; null, as
/// at the beginning: they are waited for.
void abandon_threads_by(Abandon abandon);
/// As above, for kProcessEndNs, and with the program's word.
void join_in_time(Thread* thread);
void join_as_it_works(Thread* thread, const std::function<std::uint64_t()>& done, TimeNs patience_ns);

/// As at the beginning; for tests, which end more than once.
void forget_process_end();

}  // namespace godwit::rt
