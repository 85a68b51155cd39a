#include "firmware_app/commands/record_command.h"

#include <fmt/format.h>
#include <unistd.h>

#include "firmware_app/commands/stopped.h"
#include "firmware_app/flight/devices.h"
#include "firmware_app/output/recorder.h"
#include "firmware_app/program/exit_code.h"
#include "firmware_app/program/numbers.h"
#include "hal/record_file.h"

namespace godwit::app {
namespace {

void show(const Recorded& r, std::uint64_t free_bytes) {
  fmt::print(stderr, "\r{:.0f} s: {} pictures, {} missed, {} dropped, {} bad; {} samples; {:.1f} GB free ", r.seconds,
             r.pictures, r.missed, r.dropped, r.bad, r.samples, static_cast<double>(free_bytes) * 1e-9);
}

}  // namespace

void add_record_command(CLI::App* app, RecordArguments* a) {
  CLI::App* const c = app->add_subcommand("record", "Write what camera and IMU give into a folder that replay takes");
  c->add_option("--config", a->config, "Configuration: its [camera] and [imu] are the devices")
      ->type_name("FILE")
      ->required();
  c->add_option("OUT", a->out, "Folder; it must not hold a recording")->required();
  c->add_option("--seconds", a->seconds, "How long; without it until Ctrl-C")->check(number(1e-3, kLongSeconds));
  c->add_flag("--no-camera", a->no_camera, "The IMU alone, for godwit calibrate imu");
}

int run_record(const RecordArguments& a, const std::atomic<bool>& stop) {
  ConfigReport report = load_config(a.config);
  if (a.no_camera) report.config.camera.source = Config::Camera::Source::kNone;
  if (report.ok()) check_devices(&report);
  for (const std::string& mistake : report.mistakes) fmt::print(stderr, "godwit: {}\n", mistake);
  if (!report.ok()) return kExitRefused;
  const Config& config = report.config;
  const DeviceLog log = [](const std::string& text) { fmt::print(stderr, "\ngodwit: {}\n", text); };
  OpenedCamera camera;
  RecorderOptions options;
  if (config.camera.live()) {
    auto opened = open_camera(config.camera, log, config.threads.camera);
    if (!opened) return stopped(opened.error().message, kExitRefused);
    camera = std::move(opened).value();
    const auto text = hal::read_text_file(config.camera.calibration);
    if (text) options.calibration = text.value();
  } else if (config.camera.source == Config::Camera::Source::kSim) {
    return stopped("camera.source: a simulated flight is written by godwit sim; \"v4l2\" or \"libcamera\" is allowed",
                   kExitRefused);
  }
  auto imu = open_imu(config.imu, log);
  if (!imu) return stopped(imu.error().message, kExitRefused);
  if (camera.camera == nullptr && imu.value() == nullptr) {
    return stopped("neither camera.source nor imu.source names a device", kExitRefused);
  }
  options.out = a.out;
  options.seconds = a.seconds;
  const auto done = record_devices(camera.camera.get(), imu.value().get(), options,
                                   isatty(STDERR_FILENO) != 0 ? show : RecorderProgress(), stop);
  if (!done) return stopped(done.error().message, kExitFailed);
  const Recorded& r = done.value();
  fmt::print("{}{} pictures, {} missed by the driver, {} dropped, {} bad; {} samples, {} faults; {:.1f} s in {}\n",
             r.disc_full ? "the disc is nearly full: ended. " : "", r.pictures, r.missed, r.dropped, r.bad, r.samples,
             r.imu_faults, r.seconds, a.out);
  // Whoever records wants to know now, not when it is replayed.
  const bool no_picture = camera.camera != nullptr && r.pictures == 0;
  const bool no_sample = imu.value() != nullptr && r.samples == 0;
  if (no_picture) fmt::print(stderr, "godwit: no picture came from {}\n", config.camera.device);
  if (no_sample) fmt::print(stderr, "godwit: no sample came from {}\n", config.imu.device);
  return r.disc_full || no_picture || no_sample ? kExitFailed : kExitDone;
}

}  // namespace godwit::app
