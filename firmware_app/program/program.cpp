#include "firmware_app/program/program.h"

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <fcntl.h>
#include <string>
#include <unistd.h>

#include "firmware_app/output/event_signal.h"
#include "firmware_app/output/line_log.h"
#include "firmware_app/program/exit_code.h"
#include "hal/rt/process_end.h"

namespace godwit::app {
namespace {

// Written by the signal handler, read by the pipeline; lock-free, as a handler needs it.
std::atomic<bool> stop{false};
static_assert(std::atomic<bool>::is_always_lock_free);

/// A reader of the log that takes longer is not waited for at the end.
constexpr rt::TimeNs kLogPatienceNs = rt::kNsPerSecond;
/// However late it is, a reader that reads has so long.
constexpr rt::TimeNs kLeastLogPatienceNs = 500 * rt::kNsPerMs;

void flush_log() {
  error_log().flush(std::max(rt::patience_left_ns(kLogPatienceNs), kLeastLogPatienceNs));
}

void on_signal(int /*signal*/) {
  stop.store(true, std::memory_order_relaxed);
}

/// A standard stream that whoever started us had closed would be the first file or bus that is opened, and what is said
/// would go there.
void fill_standard_streams() {
  int fd = open("/dev/null", O_RDWR | O_CLOEXEC);
  while (fd >= 0 && fd <= STDERR_FILENO) fd = open("/dev/null", O_RDWR | O_CLOEXEC);
  if (fd >= 0) close(fd);
}

/// False: what was said on the standard output did not all arrive, which is told.
bool told_all(const char* name) {
  errno = 0;
  if (std::fflush(stdout) == 0 && std::ferror(stdout) == 0) return true;
  error_log().put(std::string(name) +
                  ": standard output: " + (errno != 0 ? std::strerror(errno) : "cannot be written"));
  return false;
}

}  // namespace

int run_program(const char* name, int (*run)(int argc, char** argv, const std::atomic<bool>& stop), int argc,
                char** argv) {
  fill_standard_streams();
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
  // A file-size limit shall fail the write, which is told, not kill the process. So shall a reader that goes away. A
  // terminal that closes ends no flight.
  std::signal(SIGXFSZ, SIG_IGN);
  std::signal(SIGPIPE, SIG_IGN);
  std::signal(SIGHUP, SIG_IGN);
  block_event_signal();
  rt::abandon_threads_by([name](const char* thread) {
    std::fflush(stdout);
    end_without(name, thread, kExitFailed);
  });
  int code = kExitFailed;
  try {
    code = run(argc, argv, stop);
  } catch (const std::exception& e) {  // std::bad_alloc, or a library that throws where it should not
    error_log().put(std::string(name) + ": " + e.what());
  }
  if (!told_all(name) && code == kExitDone) code = kExitFailed;
  flush_log();
  return code;
}

void end_without(const char* name, const char* thread, int code) {
  error_log().put(std::string(name) + ": " + thread + " does not end: ending without it");
  flush_log();
  std::_Exit(code);
}

}  // namespace godwit::app
