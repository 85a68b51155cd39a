#include "firmware_app/daemon/end_guard.h"

#include <cstdlib>
#include <gtest/gtest.h>

#include "firmware_app/program/exit_code.h"
#include "hal/rt/process_end.h"
#include "hal/rt/wake_up.h"

namespace godwit::app {
namespace {

/// What a main thread does that hangs; one that is waited for ends by itself, and otherwise.
[[noreturn]] void hang() {
  rt::sleep_until_ns(rt::monotonic_now_ns() + 60 * rt::kNsPerSecond);
  std::_Exit(77);
}

TEST(EndGuardDeathTest, AMainThreadThatHangsKeepsNoEndAway) {
  EXPECT_EXIT(
      {
        const std::atomic<bool> stop{true};
        const EndGuard guard(stop, {});
        hang();
      },
      testing::ExitedWithCode(kExitFailed), "godwitd: the main thread does not end: ending without it");
}

TEST(EndGuardDeathTest, ADevicesThreadThatHangsIsNamed) {
  EXPECT_EXIT(
      {
        const std::atomic<bool> stop{true};
        const EndGuard guard(stop, {});
        rt::Thread device;
        if (!device.start("gw-device", {}, hang)) std::_Exit(78);
        rt::join_in_time(&device);
        std::_Exit(79);
      },
      testing::ExitedWithCode(kExitFailed), "godwitd: gw-device does not end: ending without it");
}

// An order over the bus to start anew, and then something hangs: systemd is to start it anew all the same.
TEST(EndGuardDeathTest, ARestartThatWasOrderedIsItsExitCodeAlsoWhereSomethingHangs) {
  EXPECT_EXIT(
      {
        const std::atomic<bool> stop{false};
        EndGuard guard(stop, {});
        guard.watch({[] { return true; }, [] { return true; }});
        hang();
      },
      testing::ExitedWithCode(kExitRestart), "godwitd: the main thread does not end: ending without it");
}

TEST(EndGuardDeathTest, ARestartIsNotForgottenWhereTheLinkIsGoneAlready) {
  EXPECT_EXIT(
      {
        const std::atomic<bool> stop{true};
        EndGuard guard(stop, {});
        guard.watch({nullptr, [] { return true; }});
        guard.watch({});
        hang();
      },
      testing::ExitedWithCode(kExitRestart), "");
}

TEST(EndGuard, WhileNobodyWantsTheEndNoTimeRuns) {
  const std::atomic<bool> stop{false};
  const EndGuard guard(stop, {});
  EXPECT_TRUE(guard.trouble().empty());
  rt::sleep_until_ns(rt::monotonic_now_ns() + 200 * rt::kNsPerMs);
  EXPECT_EQ(rt::process_end_ns(), rt::kNoEnd);
}

}  // namespace
}  // namespace godwit::app
