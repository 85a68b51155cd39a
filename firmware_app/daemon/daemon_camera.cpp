#include "firmware_app/daemon/daemon_camera.h"

#include <fmt/format.h>

#include "firmware_app/flight/devices.h"
#include "firmware_app/flight/scenario_folder.h"
#include "firmware_app/sim/flight_calibration.h"
#include "firmware_app/sim/looped_pictures.h"
#include "firmware_app/sim/picture_memory.h"
#include "hal/camera/replay/replay_camera.h"
#include "hal/record_file.h"
#include "hal/rt/wake_up.h"

namespace godwit::app {
namespace {

/// Between two looks for a recording that is not there.
constexpr rt::TimeNs kLookNs = 100 * rt::kNsPerMs;
/// Forth and back for longer than any machine runs: 30 years of two pictures at 30 a second.
constexpr std::int64_t kWithoutEnd = 30'000'000'000;

/// What of a camera is there without it: its calibration. Whatever is wrong with it is told when it is opened.
std::optional<hal::CameraCalibration> peek_calibration(const Config::Camera& config) {
  std::string file = config.calibration;
  if (config.source == Config::Camera::Source::kReplay) {
    const auto layout = hal::find_sequence(config.sequence);
    if (!layout) return std::nullopt;
    file = layout.value().calibration_file;
  }
  const auto text = hal::read_text_file(file);
  if (!text) return std::nullopt;
  auto parsed = hal::parse_calibration(text.value(), file);
  if (!parsed) return std::nullopt;
  return parsed.value();
}

}  // namespace

rt::Result<DaemonCamera> DaemonCamera::find(const Config::Camera& config, bool once) {
  DaemonCamera out;
  if (once) out.once_ = std::make_unique<hal::ReplayTime>();
  if (config.source != Config::Camera::Source::kSim) {
    out.calibration_ = peek_calibration(config);
    return out;
  }
  const auto scenario = sim::find_scenario(config.scenario, scenario_folder(config.scenarios));
  if (!scenario) return scenario.error();
  out.flight_ = std::make_unique<sim::Flight>(scenario.value(), config.seed);
  out.calibration_ = calibration_of(*out.flight_);
  return out;
}

rt::Result<void> DaemonCamera::open(const Config::Camera& config, const rt::ThreadPlan& feeder, const Say& say,
                                    const std::function<void()>& waiting, const std::atomic<bool>& stop) {
  if (flight_ != nullptr) return render(config, say, stop);
  if (config.source == Config::Camera::Source::kReplay) return replay(config, say, waiting, stop);
  auto device = open_camera(config, say, feeder);
  if (!device) return device.error();
  calibration_ = device.value().calibration;
  camera_ = std::move(device.value().camera);
  return {};
}

rt::Result<void> DaemonCamera::render(const Config::Camera& config, const Say& say, const std::atomic<bool>& stop) {
  const auto rendered = flight_->camera(0);
  LoopedPictures::Options options;
  options.interval_ns = static_cast<rt::TimeNs>(1e9 / calibration_->fps);
  options.once = once_.get();
  if (const auto room = room_for_pictures(config.pictures, rendered->width(), rendered->height()); !room) {
    return rt::Error{"camera.pictures: " + room.error().message};
  }
  say(fmt::format("rendering {} pictures of {}, seed {}", config.pictures, config.scenario, config.seed));
  auto camera = LoopedPictures::record(rendered.get(), config.pictures, options, stop);
  if (!camera) return camera.error();
  camera_ = std::move(camera).value();
  return {};
}

rt::Result<void> DaemonCamera::replay(const Config::Camera& config, const Say& say,
                                      const std::function<void()>& waiting, const std::atomic<bool>& stop) {
  hal::ReplayOptions options;
  options.pace = hal::ReplayOptions::Pace::kReal;
  options.passes = once_ != nullptr ? 1 : kWithoutEnd;
  options.time = once_.get();
  std::string told;
  while (!stop.load(std::memory_order_relaxed)) {
    auto camera = hal::ReplayCamera::open(config.sequence, options);
    if (camera) {
      if (!told.empty()) say("camera: " + config.sequence + " is there");
      if (const std::string& words = camera.value()->cut_off(); !words.empty()) say("warning: camera: " + words);
      calibration_ = camera.value()->calibration();
      camera_ = std::move(camera).value();
      return {};
    }
    if (camera.error().message != told) {
      told = camera.error().message;
      say("warning: camera: " + told + "; it is looked for");
    }
    waiting();
    rt::sleep_until_ns(rt::monotonic_now_ns() + kLookNs);
  }
  return rt::Error{"stopped"};
}

}  // namespace godwit::app
