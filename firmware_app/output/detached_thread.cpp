#include "firmware_app/output/detached_thread.h"

#include <csignal>
#include <memory>
#include <pthread.h>
#include <utility>

namespace godwit::app {
namespace {

constexpr std::size_t kStackBytes = 256 * 1024;

struct Passed {
  const char* name;
  std::function<void()> body;
};

void* run(void* passed) {
  const std::unique_ptr<Passed> own(static_cast<Passed*>(passed));
  pthread_setname_np(pthread_self(), own->name);
  own->body();
  return nullptr;
}

}  // namespace

bool start_detached(const char* name, std::function<void()> body) {
  auto passed = std::make_unique<Passed>(Passed{name, std::move(body)});
  pthread_attr_t attributes;
  if (pthread_attr_init(&attributes) != 0) return false;
  pthread_attr_setdetachstate(&attributes, PTHREAD_CREATE_DETACHED);
  pthread_attr_setstacksize(&attributes, kStackBytes);
  // Signals are the other threads' business.
  sigset_t all, before;
  sigfillset(&all);
  pthread_sigmask(SIG_SETMASK, &all, &before);
  pthread_t thread{};
  const bool started = pthread_create(&thread, &attributes, run, passed.get()) == 0;
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
  pthread_attr_destroy(&attributes);
  if (started) (void)passed.release();  // the thread's own
  return started;
}

}  // namespace godwit::app
