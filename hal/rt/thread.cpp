#include "hal/rt/thread.h"

#include <cassert>
#include <cerrno>
#include <cstring>
#include <sched.h>
#include <sys/mman.h>
#include <utility>

namespace godwit::rt {
namespace {
constexpr std::size_t kGuardBytes = 4096;
/// What untouched stack holds: the deepest place that holds something else was used.
constexpr std::uint8_t kUntouched = 0xa5;

std::string joined(const std::vector<int>& numbers) {
  std::string out;
  for (const int n : numbers) {
    if (!out.empty()) out.push_back(',');
    out.append(std::to_string(n));
  }
  return out;
}
}  // namespace

std::string apply_plan(pthread_t thread, const char* name, const ThreadPlan& plan) {
  std::string refused;
  pthread_setname_np(thread, std::string(name).substr(0, 15).c_str());
  if (!plan.cpus.empty()) {
    cpu_set_t set;
    CPU_ZERO(&set);
    for (const int cpu : plan.cpus) {
      if (cpu >= 0 && cpu < CPU_SETSIZE) CPU_SET(cpu, &set);
    }
    const int error = pthread_setaffinity_np(thread, sizeof(set), &set);
    if (error != 0) refused.append("processors ").append(joined(plan.cpus)).append(": ").append(std::strerror(error));
  }
  if (plan.priority > 0) {
    sched_param parameters{};
    parameters.sched_priority = plan.priority;
    const int error = pthread_setschedparam(thread, SCHED_FIFO, &parameters);
    if (error != 0) {
      if (!refused.empty()) refused.append("; ");
      refused.append("SCHED_FIFO priority ").append(std::to_string(plan.priority)).append(": ");
      refused.append(std::strerror(error));
    }
  }
  if (!refused.empty()) refused.insert(0, ": ").insert(0, name);
  return refused;
}

Thread::~Thread() {
  assert(!running_);
  if (stack_ != nullptr) munmap(stack_, kGuardBytes + kThreadStackBytes);
}

void* Thread::run(void* self) {
  auto* const thread = static_cast<Thread*>(self);
  while (!thread->planned_.wait_for(kNsPerSecond)) {
  }
  thread->body_();
  // Now, because a C library as old as 2.31 gives the stack's pages back to the kernel when its thread ends.
  thread->stack_at_end_ = thread->stack_used_now();
  thread->ended_.store(true, std::memory_order_release);
  return nullptr;
}

Result<void> Thread::start(const char* name, const ThreadPlan& plan, std::function<void()> body) {
  assert(!running_);
  if (stack_ == nullptr) {
    void* const memory = mmap(nullptr, kGuardBytes + kThreadStackBytes, PROT_READ | PROT_WRITE,
                              MAP_PRIVATE | MAP_ANONYMOUS | MAP_STACK, -1, 0);
    if (memory == MAP_FAILED) return Error{std::string(name) + ": no memory for its stack: " + std::strerror(errno)};
    stack_ = static_cast<std::uint8_t*>(memory);
    mprotect(stack_, kGuardBytes, PROT_NONE);
  }
  std::memset(stack_ + kGuardBytes, kUntouched, kThreadStackBytes);
  stack_at_end_ = 0;
  ended_.store(false, std::memory_order_relaxed);  // pthread_create() orders it
  name_ = name;
  body_ = std::move(body);
  pthread_attr_t attributes;
  pthread_attr_init(&attributes);
  pthread_attr_setstack(&attributes, stack_ + kGuardBytes, kThreadStackBytes);
  const int error = pthread_create(&id_, &attributes, &Thread::run, this);
  pthread_attr_destroy(&attributes);
  if (error != 0) return Error{std::string(name) + ": cannot start: " + std::strerror(error)};
  running_ = true;
  warning_ = apply_plan(id_, name, plan);
  planned_.post();
  return {};
}

void Thread::join() {
  if (!running_) return;
  pthread_join(id_, nullptr);
  running_ = false;
}

std::size_t Thread::stack_used() const {
  return running_ ? stack_used_now() : stack_at_end_;
}

std::size_t Thread::stack_used_now() const {
  if (stack_ == nullptr) return 0;
  std::size_t untouched = 0;
  while (untouched < kThreadStackBytes && stack_[kGuardBytes + untouched] == kUntouched) ++untouched;
  return kThreadStackBytes - untouched;
}

}  // namespace godwit::rt
