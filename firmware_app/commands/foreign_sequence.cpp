#include "firmware_app/commands/foreign_sequence.h"

#include <algorithm>
#include <array>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <fmt/format.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>
#include <vector>

#include "hal/atomic_file.h"
#include "hal/machine/installed_data.h"

namespace godwit::app {
namespace {

namespace fs = std::filesystem;
constexpr int kLookMs = 20;
constexpr int kNoInterpreter = 127;
/// Grey left and right, colour left and right; the colour ones are a download of their own, so image_2 often lies
/// alone.
constexpr std::array kKittiPictures{"image_0", "image_1", "image_2", "image_3"};
/// Tells a sequence that was made here from one that somebody keeps in a folder of that name.
constexpr const char* kMark = "made_by_godwit.txt";

bool is_kitti(const fs::path& folder) {
  std::error_code ignored;
  const bool pictures =
      std::ranges::any_of(kKittiPictures, [&](const char* name) { return fs::is_directory(folder / name, ignored); });
  return pictures && fs::is_regular_file(folder / "times.txt", ignored) && !fs::exists(folder / "rgb.txt", ignored);
}

/// Runs a tool of ours to its end. Error: it could not be run, or ended with another code than 0.
rt::Result<void> run_tool(const std::string& name, const std::vector<std::string>& arguments,
                          const std::atomic<bool>& stop) {
  const std::string program = hal::installed_data("tools") + "/" + name;
  std::error_code ignored;
  if (!fs::exists(program, ignored))
    return rt::Error{program + ": is not there: install the package godwit-tools (docs/service.md)"};
  std::vector<std::string> words{program};
  words.insert(words.end(), arguments.begin(), arguments.end());
  std::vector<char*> argv;
  argv.reserve(words.size() + 1);
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  // What this thread keeps from itself must not be kept from it.
  posix_spawnattr_t attributes;
  posix_spawnattr_init(&attributes);
  sigset_t none;
  sigemptyset(&none);
  posix_spawnattr_setsigmask(&attributes, &none);
  posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSIGMASK);
  pid_t child = 0;
  const int error = posix_spawn(&child, program.c_str(), nullptr, &attributes, argv.data(), environ);
  posix_spawnattr_destroy(&attributes);
  if (error != 0) return rt::Error{program + ": cannot be run: " + std::strerror(error)};
  int status = 0;
  while (waitpid(child, &status, WNOHANG) == 0) {
    if (stop.load(std::memory_order_relaxed)) kill(child, SIGTERM);
    usleep(kLookMs * 1000);
  }
  if (stop.load(std::memory_order_relaxed)) return rt::Error{"interrupted"};
  if (WIFEXITED(status) && WEXITSTATUS(status) == 0) return {};
  if (WIFEXITED(status) && WEXITSTATUS(status) == kNoInterpreter) return rt::Error{program + ": needs python3"};
  return rt::Error{name + " could not make a sequence of it; the reason stands above"};
}

rt::Result<void> leave_mark(const fs::path& made, const std::string& of) {
  hal::AtomicFile file;
  if (auto opened = file.open((made / kMark).string()); !opened) return opened;
  const auto written = file.write("Made of " + of +
                                  ". The next godwit replay of a video or of KITTI's folders with the same --out\n"
                                  "makes this folder anew, as long as this file is in it.\n");
  return written ? file.commit() : written;
}

}  // namespace

rt::Result<std::string> as_sequence(const std::string& sequence, const VideoCamera& camera, const std::string& out,
                                    const std::atomic<bool>& stop) {
  std::error_code error;
  const bool video = fs::is_regular_file(sequence, error);
  const bool told = !camera.calibration.empty() || camera.fov_deg > 0;
  if (!fs::exists(sequence, error)) return rt::Error{sequence + ": No such file or folder"};
  if (told && !video) return rt::Error{"--camera, --fov: are for a video; a sequence has its calibration beside it"};
  if (!video && !is_kitti(sequence)) return sequence;
  if (video && !told)
    return rt::Error{sequence +
                     ": a video does not say how its camera sees: add --camera camera.yaml (docs/formats.md), " +
                     "or for a first look --fov DEG"};
  if (!camera.calibration.empty() && camera.fov_deg > 0) return rt::Error{"--camera and --fov: one of them"};
  const fs::path made = fs::path(out) / "sequence";
  // Only what an earlier run made there is taken away.
  if (fs::exists(made, error) && !fs::exists(made / kMark, error) &&
      (!fs::is_directory(made, error) || !fs::is_empty(made, error)))
    return rt::Error{made.string() + ": is in the way, and not made by an earlier run: another --out, or move it"};
  const fs::path inside = fs::weakly_canonical(sequence, error).lexically_relative(fs::weakly_canonical(made, error));
  if (!inside.empty() && *inside.begin() != "..")
    return rt::Error{sequence + ": lies in " + made.string() + ", which would be made anew: another --out"};
  fs::remove_all(made, error);
  fs::create_directories(out, error);
  if (error) return rt::Error{out + ": cannot make the folder: " + error.message()};
  fmt::print(stderr, "{}: becomes a sequence, {}\n", sequence, made.string());
  std::vector<std::string> words{sequence, made.string()};
  if (!camera.calibration.empty()) words.insert(words.end(), {"--camera", camera.calibration});
  if (camera.fov_deg > 0) words.insert(words.end(), {"--fov", fmt::format("{}", camera.fov_deg)});
  auto done = run_tool(video ? "from_video" : "from_kitti", words, stop);
  if (done) done = leave_mark(made, sequence);
  if (done) return made.string();
  // Half a sequence would be in the way of the next run.
  fs::remove_all(made, error);
  return done.error();
}

}  // namespace godwit::app
