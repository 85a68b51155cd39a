// godwitd as a program: what it links, how it starts, how it ends.
#include <algorithm>
#include <array>
#include <chrono>
#include <condition_variable>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <fcntl.h>
#include <filesystem>
#include <fstream>
#include <gmock/gmock.h>
#include <grp.h>
#include <gtest/gtest.h>
#include <mutex>
#include <string>
#include <sys/resource.h>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>

#include "hal/rt/time.h"
#include "hal/rt/wake_up.h"
#include "tests/app/small_flight.h"
#include "tests/support/run_command.h"
#include "tests/support/temp_folder.h"

namespace godwit::app::daemon_test {
namespace {

using testing::HasSubstr;
using testing::Not;

/// Gives up all that a real-time program needs: root, its capabilities, and the limits that stand in for them. Child
/// process, before exec.
void become_nobody() {
  constexpr uid_t kNobody = 65534;
  const rlimit nothing{0, 0};
  bool done = setrlimit(RLIMIT_MEMLOCK, &nothing) == 0 && setrlimit(RLIMIT_RTPRIO, &nothing) == 0;
  if (geteuid() == 0) {
    done = done && setgroups(0, nullptr) == 0 && setresgid(kNobody, kNobody, kNobody) == 0 &&
           setresuid(kNobody, kNobody, kNobody) == 0;
  }
  if (!done) _exit(126);
}

/// A running godwitd.
class Daemon {
 public:
  enum class Log { kRead, kClosed, kStuck };
  explicit Daemon(const std::string& config, bool as_nobody = false, Log log = Log::kRead,
                  rlim_t most_bytes = RLIM_INFINITY) {
    // Opened while we may: nobody need not find the way to the build folder.
    const int program = open(GODWIT_DAEMON, O_RDONLY | O_CLOEXEC);
    EXPECT_GE(program, 0);
    int ends[2] = {};
    EXPECT_EQ(pipe(ends), 0);
    if (log == Log::kStuck) fill(ends[1]);
    pid_ = fork();
    if (pid_ == 0) {
      const rlimit memory{most_bytes, most_bytes};
      if (most_bytes != RLIM_INFINITY && setrlimit(RLIMIT_AS, &memory) != 0) _exit(126);
      dup2(ends[1], STDERR_FILENO);
      close(ends[0]);
      if (log == Log::kClosed) {
        for (const int fd : {ends[1], STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO}) close(fd);
      }
      if (as_nobody) become_nobody();
      const char* const arguments[] = {"godwitd", "--config", config.c_str(), nullptr};
      fexecve(program, const_cast<char* const*>(arguments), environ);
      _exit(127);
    }
    close(program);
    close(ends[1]);
    said_ = fdopen(ends[0], "r");
  }
  ~Daemon() {
    if (pid_ > 0) kill(pid_, SIGKILL), waitpid(pid_, nullptr, 0);
    stop_reading();
  }
  void stop_reading() {
    if (said_ != nullptr) std::fclose(said_);
    said_ = nullptr;
  }
  void signal(int signal) const { kill(pid_, signal); }
  /// Reads on until a line holds this. False: it ended before, or was ended, since this did not come in two minutes.
  bool says(const std::string& words) {
    std::mutex mutex;
    std::condition_variable_any change;
    const std::jthread limit([&](const std::stop_token& found) {
      std::unique_lock<std::mutex> lock(mutex);
      change.wait_for(lock, found, std::chrono::minutes(2), [] { return false; });
      if (!found.stop_requested() && pid_ > 0) kill(pid_, SIGKILL);
    });
    std::array<char, 4096> line{};
    while (said_ != nullptr && std::fgets(line.data(), line.size(), said_) != nullptr) {
      all_ += line.data();
      if (std::string(line.data()).find(words) != std::string::npos) return true;
    }
    return false;
  }
  /// Sends the signal and waits for the end. Exit code; how long it took.
  int end(int signal, rt::TimeNs* took) {
    const rt::TimeNs before = rt::monotonic_now_ns();
    kill(pid_, signal);
    int status = 0;
    waitpid(pid_, &status, 0);
    pid_ = -1;
    *took = rt::monotonic_now_ns() - before;
    says("\n\n");
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }
  const std::string& all() const { return all_; }
  /// What a descriptor of it is.
  std::string open_as(int fd) const {
    std::error_code gone;
    return std::filesystem::read_symlink("/proc/" + std::to_string(pid_) + "/fd/" + std::to_string(fd), gone);
  }

 private:
  /// A pipe that takes nothing more.
  static void fill(int end) {
    const std::array<char, 4096> block{};
    fcntl(end, F_SETFL, O_NONBLOCK);
    while (write(end, block.data(), block.size()) > 0) {
    }
    fcntl(end, F_SETFL, 0);
  }

  pid_t pid_ = -1;
  std::FILE* said_ = nullptr;
  std::string all_;
};

TEST(Godwitd, DecodesNoPicturesAndOpensNoVideo) {
  const auto [code, libraries] = test::run_command("ldd " GODWIT_DAEMON);
  ASSERT_EQ(code, 0);
  ASSERT_THAT(libraries, HasSubstr("libc.so")) << "ldd told the libraries at all";
  for (const char* library : {"imgcodecs", "videoio", "highgui"}) EXPECT_THAT(libraries, Not(HasSubstr(library)));
  ASSERT_THAT(test::run_command("ldd " GODWIT_TOOL).text, HasSubstr("imgcodecs"))
      << "and would be found if it were there";
}

TEST(Godwitd, TheLogBeginsWithTheVersionAndArmedIsNotSaidWhereNothingIsLocked) {
  const test::TempFolder folder;
  Daemon daemon(write_config(folder, kSmallFlight));
  ASSERT_TRUE(daemon.says("flying, not armed: threads.lock_memory is off")) << daemon.all();
  EXPECT_THAT(daemon.all(), testing::StartsWith("godwitd: godwitd "));
  EXPECT_THAT(daemon.all().substr(0, daemon.all().find('\n')),
              testing::ContainsRegex("\\(commit ([0-9a-f]{12}(-dirty)?|unknown)\\)$"));
  EXPECT_THAT(daemon.all(), Not(HasSubstr("godwitd: armed")));
  EXPECT_THAT(daemon.all(), testing::ContainsRegex("temperature: the hottest of |no thermal zone tells"));
  rt::TimeNs took = 0;
  EXPECT_EQ(daemon.end(SIGTERM, &took), 0);
}

TEST(Godwitd, SigtermAndSigintEndItCleanly) {
  const test::TempFolder folder;
  const std::string config = write_config(folder, kSmallFlight);
  for (const int how : {SIGINT, SIGTERM}) {
    Daemon daemon(config);
    ASSERT_TRUE(daemon.says("INITIALISING")) << daemon.all();
    rt::TimeNs took = 0;
    EXPECT_EQ(daemon.end(how, &took), 0) << daemon.all();
    EXPECT_THAT(daemon.all(), HasSubstr("frames, ")) << "the last words are the counts";
    RecordProperty("ms", std::to_string(took / rt::kNsPerMs));
    // How long it takes is benchmarks/service_bars' to say: a machine that compiles has made it six seconds, of the
    // unit's five. That whoever hangs does not keep it from ending: EndGuardDeathTest.
  }
}

TEST(Godwitd, TheScenariosInertialSensorIsFlownByOnceForthAndTheFlightEnds) {
  const test::TempFolder folder;
  const std::string camera = "[camera]\nsource = \"sim\"\nscenario = \"corridor\"\nscenarios = \"" GODWIT_SCENARIO_DIR
                             "\"\npictures = 12\n[detector]\nenabled = false\n";
  for (const bool enabled : {true, false}) {
    Daemon daemon(
        write_config(folder, camera + "[imu]\nsource = \"sim\"\nenabled = " + (enabled ? "true" : "false") + "\n"));
    ASSERT_TRUE(daemon.says(enabled ? "IMU: flown by" : "IMU: watched, not flown by")) << daemon.all();
    ASSERT_TRUE(daemon.says("12 frames, ")) << "not forth and back: " << daemon.all();
    ASSERT_TRUE(daemon.says("IMU: ")) << daemon.all();
    EXPECT_THAT(daemon.all(), Not(HasSubstr("IMU: 0 samples")));
    rt::TimeNs took = 0;
    EXPECT_EQ(daemon.end(0, &took), 0);
  }
}

TEST(Godwitd, NobodyReadsTheLogAndItFliesOn) {
  const test::TempFolder folder;
  Daemon daemon(write_config(folder, kSmallFlight + "[can]\nbus = \"multicast:9:127.0.0.1\"\nnode_id = 43\n"));
  ASSERT_TRUE(daemon.says("INITIALISING")) << daemon.all();
  daemon.stop_reading();
  rt::sleep_until_ns(rt::monotonic_now_ns() + 2 * rt::kNsPerSecond);
  rt::TimeNs took = 0;
  EXPECT_EQ(daemon.end(SIGTERM, &took), 0) << "neither killed by a signal nor failed";
}

TEST(Godwitd, AStuckReaderOfTheLogHoldsUpNeitherFlightNorEnd) {
  const test::TempFolder folder;
  const std::string flights = folder / "flights";
  Daemon daemon(write_config(folder, kSmallFlight + "[flight_log]\nfolder = \"" + flights + "\"\n"), false,
                Daemon::Log::kStuck);
  // What it flies is to be seen in its flight log alone.
  const auto flown = [&] {
    return std::filesystem::exists(flights + "/000001.ulg") &&
           test::read_file(flights + "/000001.ulg").find("INITIALISING") != std::string::npos;
  };
  const rt::TimeNs give_up_ns = rt::monotonic_now_ns() + 60 * rt::kNsPerSecond;
  while (!flown() && rt::monotonic_now_ns() < give_up_ns) {
    rt::sleep_until_ns(rt::monotonic_now_ns() + 10 * rt::kNsPerMs);
  }
  EXPECT_TRUE(flown());
  rt::TimeNs took = 0;  // the pipe is full until then
  EXPECT_EQ(daemon.end(SIGTERM, &took), 0);
}

// Whoever starts it may have closed them: what it says would go to the file that is opened first, or onto the bus.
TEST(Godwitd, StandardStreamsThatAreClosedBecomeNoFileAndNoBus) {
  const test::TempFolder folder;
  const std::string lock = folder / "lock";
  Daemon daemon(write_config(folder, kSmallFlight + "[can]\nbus = \"multicast:9:127.0.0.1\"\nnode_id = 44\n" +
                                         "[link]\nstate_folder = \"" + folder.path().string() + "\"\n"),
                false, Daemon::Log::kClosed);
  // Kept open from the moment that the bus is there.
  const rt::TimeNs give_up_ns = rt::monotonic_now_ns() + 30 * rt::kNsPerSecond;
  const auto has_lock = [&] {
    for (int fd = 0; fd < 20; ++fd) {
      if (daemon.open_as(fd) == lock) return true;
    }
    return false;
  };
  while (!has_lock() && rt::monotonic_now_ns() < give_up_ns) rt::sleep_until_ns(rt::monotonic_now_ns() + rt::kNsPerMs);
  ASSERT_TRUE(has_lock());
  for (const int fd : {0, 1, 2}) EXPECT_EQ(daemon.open_as(fd), "/dev/null") << fd;
  rt::TimeNs took = 0;
  EXPECT_EQ(daemon.end(SIGTERM, &took), 0);
}

TEST(Godwitd, WritesEachFlightDown) {
  const test::TempFolder folder;
  const std::string flights = folder / "flights";
  const std::string config = write_config(folder, kSmallFlight + "[flight_log]\nfolder = \"" + flights + "\"\n");
  for (const char* file : {"000001.ulg", "000002.ulg"}) {
    Daemon daemon(config);
    ASSERT_TRUE(daemon.says("INITIALISING")) << daemon.all();
    EXPECT_THAT(daemon.all(), HasSubstr("flight log: " + flights));
    rt::TimeNs took = 0;
    EXPECT_EQ(daemon.end(SIGTERM, &took), 0);
    EXPECT_THAT(daemon.all(), HasSubstr("in 1 files, 0 messages dropped"));
    const std::string bytes = test::read_file(flights + "/" + file);
    for (const char* part : {"ULog", "sys_name", "camera.source", "sequence", "INITIALISING"}) {
      EXPECT_THAT(bytes, HasSubstr(part)) << file;
    }
    EXPECT_THAT(bytes, Not(HasSubstr("ver_sw_release"))) << "a number by ULog's definition: pyulog fails on words";
  }
}

TEST(Godwitd, AFlightLogThatCannotBeWrittenGroundsNobody) {
  const test::TempFolder folder;
  Daemon daemon(write_config(folder, kSmallFlight + "[flight_log]\nfolder = \"/proc/no/such/folder\"\n"));
  ASSERT_TRUE(daemon.says("INITIALISING")) << daemon.all();
  rt::TimeNs took = 0;
  EXPECT_EQ(daemon.end(SIGTERM, &took), 0);
  EXPECT_THAT(daemon.all(), HasSubstr("a file cannot be made"));
}

TEST(Godwitd, AnEventRecorderWithoutMemoryGroundsNobody) {
  const test::TempFolder folder;
  // 121 s of pictures are 1.1 GB, which is more than all that it may have; without them it needs some 300 MB.
  Daemon daemon(
      write_config(folder, kSmallFlight + "[detector]\nenabled = false\n[recorder]\nfolder = \"" + (folder / "events") +
                               "\"\nbefore_s = 60\nafter_s = 60\nmemory_mb = 2000\nbudget_mb = 2000\n"),
      false, Daemon::Log::kRead, 1'000'000'000);
  ASSERT_TRUE(daemon.says("INITIALISING")) << daemon.all();
  EXPECT_THAT(daemon.all(), testing::ContainsRegex("warning: event recorder: no memory for .*; it flies without"));
  rt::TimeNs took = 0;
  EXPECT_EQ(daemon.end(SIGTERM, &took), 0);
}

TEST(Godwitd, ATerminalThatClosesEndsNoFlight) {
  const test::TempFolder folder;
  Daemon daemon(write_config(folder, kSmallFlight));
  ASSERT_TRUE(daemon.says("INITIALISING")) << daemon.all();
  daemon.signal(SIGHUP);
  rt::sleep_until_ns(rt::monotonic_now_ns() + 300 * rt::kNsPerMs);
  rt::TimeNs took = 0;
  EXPECT_EQ(daemon.end(SIGTERM, &took), 0);
}

TEST(Godwitd, SigtermEndsItWhilePicturesAreRendered) {
  const test::TempFolder folder;
  Daemon daemon(write_config(folder,
                             "[camera]\nsource = \"sim\"\nscenario = \"corridor\"\nscenarios = \"" GODWIT_SCENARIO_DIR
                             "\"\npictures = 10000\n"));
  ASSERT_TRUE(daemon.says("rendering"));
  rt::TimeNs took = 0;
  EXPECT_EQ(daemon.end(SIGTERM, &took), 0);
}

TEST(Godwitd, WithoutPrivilegesOneWarningAndOnItFlies) {
  namespace fs = std::filesystem;
  const test::TempFolder folder;
  fs::permissions(folder.path(), fs::perms::others_read | fs::perms::others_exec, fs::perm_options::add);
  fs::copy(GODWIT_SCENARIO_DIR, folder.path() / "scenarios");
  fs::copy(GODWIT_MODEL_DIR, folder.path() / "models");
  Daemon daemon(write_config(folder, "[camera]\nsource = \"sim\"\nscenario = \"corridor\"\nscenarios = \"" +
                                         (folder / "scenarios") + "\"\npictures = 2\n[detector]\nmodel = \"" +
                                         (folder / "models/cbam_yolov5n_416.onnx") +
                                         "\"\n"
                                         "[threads]\nlock_memory = true\n[threads.camera]\npriority = 60\n"
                                         "[threads.tracker]\npriority = 50\n[threads.mapper]\npriority = 10\n"),
                true);
  ASSERT_TRUE(daemon.says("armed")) << daemon.all();
  ASSERT_TRUE(daemon.says("INITIALISING")) << "it flies";
  rt::TimeNs took = 0;
  EXPECT_EQ(daemon.end(SIGTERM, &took), 0);
  const std::string& said = daemon.all();
  const std::size_t warning = said.find("warning: not real-time, flying on without: memory is not locked: ");
  ASSERT_NE(warning, std::string::npos) << said;
  EXPECT_EQ(said.find("warning", warning + 1), std::string::npos) << "one, not many:\n" << said;
  const std::string line = said.substr(warning, said.find('\n', warning) - warning);
  for (const char* refused : {"gw-camera: SCHED_FIFO priority 60: ", "gw-tracker: SCHED_FIFO priority 50: ",
                              "gw-mapper: SCHED_FIFO priority 10: "}) {
    EXPECT_THAT(line, HasSubstr(refused));
  }
}

TEST(Godwitd, WithPrivilegesItDoesNotWarn) {
  if (geteuid() != 0) {
    const char* ci = std::getenv("CI");
    if (ci != nullptr && std::string(ci) == "true") FAIL() << "needs root: SCHED_FIFO and locked memory";
    GTEST_SKIP() << "needs root: SCHED_FIFO and locked memory";
  }
  const test::TempFolder folder;
  Daemon daemon(write_config(
      folder,
      kSmallFlight +
          "[threads]\nlock_memory = true\n[threads.tracker]\npriority = 50\n[threads.camera]\npriority = 60\n"));
  ASSERT_TRUE(daemon.says("INITIALISING")) << daemon.all();
  rt::TimeNs took = 0;
  EXPECT_EQ(daemon.end(SIGTERM, &took), 0);
  EXPECT_THAT(daemon.all(), Not(HasSubstr("warning")));
}

TEST(Godwitd, FindsPeopleInFlightAndSaysSo) {
  for (const char* model : {"", GODWIT_MODEL_DIR "/yolox_nano_416.onnx"}) {
    const test::TempFolder folder;
    const std::string sim = "[camera]\nsource = \"sim\"\nscenario = \"hover-in-crowd\"\npictures = 2\nscenarios = ";
    const std::string text = sim + ("\"" GODWIT_SCENARIO_DIR "\"\n[detector]\nbackend = \"cuda\"\nmodel = \"") + model;
    Daemon daemon(write_config(folder, text + "\"\n"));
    ASSERT_TRUE(daemon.says("armed")) << daemon.all();
    EXPECT_THAT(daemon.all(), HasSubstr("warning: detector: backend cuda is not available")) << "Debian's OpenCV";
    ASSERT_TRUE(daemon.says("detections come")) << daemon.all();
    rt::TimeNs took = 0;
    EXPECT_EQ(daemon.end(SIGTERM, &took), 0);
    EXPECT_THAT(daemon.all(), testing::ContainsRegex("detector: [1-9][0-9]* detections, 0 failed, "));
    EXPECT_THAT(daemon.all(), HasSubstr("thread detector: "));
  }
}

TEST(Godwitd, WithoutTheNetworkItFliesAsToldAndDoesNotSpeakOfIt) {
  const test::TempFolder folder;
  Daemon daemon(write_config(folder, kSmallFlight + "[detector]\nenabled = false\nmodel = \"/nowhere.onnx\"\n"));
  ASSERT_TRUE(daemon.says("INITIALISING")) << daemon.all();
  rt::TimeNs took = 0;
  EXPECT_EQ(daemon.end(SIGTERM, &took), 0);
  EXPECT_THAT(daemon.all(), Not(HasSubstr("detect")));
}

TEST(Godwitd, ABrokenNetworkIsNotFlownWithout) {
  const test::TempFolder folder;
  std::ofstream(folder.path() / "own.onnx") << "no network";
  std::filesystem::copy(GODWIT_MODEL_DIR "/cbam_yolov5n_320.toml", folder.path() / "own.toml");
  const std::string config =
      write_config(folder, kSmallFlight + "[detector]\nmodel = \"" + (folder / "own.onnx") + "\"\n");
  const auto [code, said] = test::run_command(GODWIT_DAEMON " --config " + config);
  EXPECT_EQ(code, 2);
  EXPECT_THAT(said, HasSubstr((folder / "own.onnx") + ": "));
  EXPECT_THAT(said, Not(HasSubstr("armed")));
}

TEST(Godwitd, RefusesToStartWithAllThatIsWrong) {
  const test::TempFolder folder;
  const std::string config = write_config(folder, "[camera]\nsource = \"film\"\npictures = 1\n");
  const auto [code, said] = test::run_command(GODWIT_DAEMON " --config " + config);
  EXPECT_EQ(code, 2);
  EXPECT_THAT(
      said,
      HasSubstr(config + ":2: camera.source: \"none\", \"sim\", \"replay\", \"v4l2\" or \"libcamera\" is allowed"));
  EXPECT_THAT(said, HasSubstr(config + ":3: camera.pictures: a whole number from 2 to 10000 is allowed"));
  EXPECT_EQ(test::run_command(GODWIT_DAEMON).exit_code, 2) << "without a configuration it does not guess one";
  const auto [none_code, none] = test::run_command(GODWIT_DAEMON " --config " + write_config(folder, ""));
  EXPECT_EQ(none_code, 2);
  EXPECT_THAT(
      none,
      HasSubstr("camera.source: a daemon needs a camera; \"v4l2\", \"libcamera\", \"replay\" or \"sim\" is allowed"));
}

}  // namespace
}  // namespace godwit::app::daemon_test
