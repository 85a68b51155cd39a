#include "firmware_app/commands/doctor_command.h"

#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <CLI/Validators.hpp>

#include "firmware_app/commands/camera_run.h"
#include "firmware_app/commands/doctor_autopilot.h"
#include "firmware_app/commands/doctor_detector.h"
#include "firmware_app/commands/doctor_imu.h"
#include "firmware_app/commands/doctor_power.h"
#include "firmware_app/commands/doctor_service.h"
#include "firmware_app/commands/doctor_tilt.h"
#include "firmware_app/commands/replay_command.h"
#include "firmware_app/config/link_settings.h"
#include "firmware_app/program/exit_code.h"

namespace godwit::app {

void add_doctor_command(CLI::App* app, DoctorArguments* a) {
  CLI::App* doctor = app->add_subcommand("doctor",
                                         "Look at camera, network, inertial sensor, service, bus and autopilot, and "
                                         "say what does not fit and what to set");
  doctor->add_option("--config", a->config_file, "Configuration (TOML); config/godwit.toml lists every key")
      ->type_name("FILE");
  add_link_options(doctor, &a->can, &a->mavlink);
  doctor->add_option("--sequence", a->sequence, "A recorded sequence in place of the configured camera")
      ->type_name("FOLDER");
  doctor
      ->add_option("--delay-ms", a->delay_ms,
                   "VISO_DELAY_MS as the last flight told it, to compare the autopilot's with")
      ->type_name("MS")
      ->check(CLI::Range(0, 250));
  doctor->add_flag(
      "--tilt", a->tilt,
      "Then guide through the tilt test: level, nose up, right side down; compares the camera's mounting with "
      "the autopilot's attitude");
  doctor->footer(
      "Exit codes: 0 all fits; 1 something does not; 2 it did not start. godwitd must not run meanwhile.\n"
      "Example: godwit doctor --config /etc/godwit.toml --tilt");
}

int run_doctor(const DoctorArguments& a, const std::atomic<bool>& stop) {
  Config config;
  if (!a.config_file.empty()) {
    const ConfigReport report = load_config(a.config_file);
    for (const std::string& mistake : report.mistakes) refuse(mistake);
    if (!report.ok()) return kExitRefused;
    config = report.config;
  }
  if (!take_link_options(a.can, a.mavlink, &config)) return kExitRefused;
  // The node's own counter of resets is not to go up by being looked at.
  config.link.state_folder.clear();

  DoctorReport report;
  DoctorCamera camera = examine_camera(config, a.sequence, &report);
  const bool known = camera.calibration.width > 0 && camera.calibration.height > 0;
  examine_detector(config, known ? camera.calibration.width : 640, known ? camera.calibration.height : 480,
                   camera.calibration.fps, &report);
  examine_imu(config, "/", &report);
  examine_power("/", &report);
  examine_service("/", config, &report);
  BusHeard heard;
  if (config.can.bus.empty()) {
    report.note("bus: none is configured (can.bus)");
  } else {
    heard = examine_bus(config, &report);
  }
  std::unique_ptr<link::LinkService> service;
  if (!wants_link(config)) {
    report.wrong("autopilot: no way to it is configured: set can.bus or link.mavlink");
  } else {
    const auto delay = a.delay_ms < 0 ? std::nullopt : std::optional<int>(a.delay_ms);
    service = examine_autopilot(config, camera.calibration, heard, delay, &report, stop);
  }
  if (a.tilt && (service == nullptr || camera.camera == nullptr)) {
    report.wrong("tilt test: it needs a camera and an autopilot");
  } else if (a.tilt) {
    tilt_test(config, &camera, service.get(), &report, stop);
  }
  if (stop.load(std::memory_order_relaxed)) return kExitInterrupted;
  fmt::print("{}\n", report.wrong_count() == 0 ? "all fits" : fmt::format("{} to mend", report.wrong_count()));
  return report.wrong_count() == 0 ? kExitDone : kExitFailed;
}

}  // namespace godwit::app
