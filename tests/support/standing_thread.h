// A thread of this process that stands still, as one does whose disc or driver hangs.
#pragma once

#include <atomic>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>
#include <string>
#include <sys/syscall.h>
#include <unistd.h>

#include "hal/rt/wake_up.h"

namespace godwit::test {

inline std::atomic<bool> thread_stands{false};

/// The thread of this name stands until let_thread_go().
inline void stop_thread(const std::string& name) {
  for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
    std::string said;
    std::getline(std::ifstream(task.path() / "comm"), said);
    if (said != name) continue;
    std::signal(SIGUSR2, [](int) {
      while (thread_stands.load()) rt::sleep_until_ns(rt::monotonic_now_ns() + rt::kNsPerMs);
    });
    thread_stands.store(true);
    syscall(SYS_tgkill, getpid(), std::stoi(task.path().filename()), SIGUSR2);
    return;
  }
  ADD_FAILURE() << "no thread " << name;
}

inline void let_thread_go() {
  thread_stands.store(false);
}

}  // namespace godwit::test
