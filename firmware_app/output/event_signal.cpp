#include "firmware_app/output/event_signal.h"

#include <csignal>
#include <ctime>

namespace godwit::app {
namespace {

sigset_t event_signal() {
  sigset_t set;
  sigemptyset(&set);
  sigaddset(&set, SIGUSR1);
  return set;
}

}  // namespace

void block_event_signal() {
  const sigset_t set = event_signal();
  pthread_sigmask(SIG_BLOCK, &set, nullptr);
}

bool take_event_signal() {
  const sigset_t set = event_signal();
  const timespec now{};
  return sigtimedwait(&set, nullptr, &now) == SIGUSR1;
}

}  // namespace godwit::app
