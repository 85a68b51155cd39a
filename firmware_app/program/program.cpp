#include "firmware_app/program/program.h"

#include <csignal>
#include <cstdio>
#include <exception>

#include "firmware_app/program/exit_code.h"

namespace godwit::app {
namespace {

// Written by the signal handler, read by the pipeline; lock-free, as a handler needs it.
std::atomic<bool> stop{false};
static_assert(std::atomic<bool>::is_always_lock_free);

void on_signal(int /*signal*/) {
  stop.store(true, std::memory_order_relaxed);
}

}  // namespace

int run_program(const char* name, int (*run)(int argc, char** argv, const std::atomic<bool>& stop), int argc,
                char** argv) {
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
  // A file-size limit shall fail the write, which is told, not kill the process.
  std::signal(SIGXFSZ, SIG_IGN);
  try {
    return run(argc, argv, stop);
  } catch (const std::exception& e) {  // std::bad_alloc, or a library that throws where it should not
    std::fprintf(stderr, "%s: %s\n", name, e.what());
    return kExitFailed;
  }
}

}  // namespace godwit::app
