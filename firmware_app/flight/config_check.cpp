#include "firmware_app/flight/config_check.h"

#include <algorithm>
#include <filesystem>

#include "firmware_app/config/link_settings.h"
#include "firmware_app/flight/devices.h"
#include "firmware_app/flight/model_files.h"
#include "firmware_app/flight/scenario_folder.h"
#include "firmware_app/pipeline/odometry_stage.h"
#include "hal/sim/flight/scenario.h"

namespace godwit::app {
namespace {

void check_cpus(const std::string& section, const rt::ThreadPlan& plan, ConfigReport* report) {
  const auto cpus = static_cast<int>(sysconf(_SC_NPROCESSORS_CONF));
  for (const int cpu : plan.cpus) {
    if (cpu < cpus) continue;
    report->mistake(section + ".cpus", "there is no processor " + std::to_string(cpu) + " on this machine; 0 to " +
                                           std::to_string(cpus - 1) + " are allowed");
  }
}

/// A scenario's own mistakes come one a line, each with file and line: they stand behind our key's.
void check_scenario(ConfigReport* report) {
  const Config::Camera& camera = report->config.camera;
  if (camera.source != Config::Camera::Source::kSim) return;
  const auto scenario = sim::find_scenario(camera.scenario, scenario_folder(camera.scenarios));
  if (scenario) return;
  std::string why = scenario.error().message;
  std::replace(why.begin(), why.end(), '\n', ';');
  report->mistake("camera.scenario", why);
}

void check_state_folder(ConfigReport* report) {
  const std::string& folder = report->config.link.state_folder;
  if (folder.empty() || !wants_link(report->config)) return;
  if (!std::filesystem::is_directory(folder)) {
    report->mistake("link.state_folder", "\"" + folder + "\" is not there or no folder");
  }
}

}  // namespace

void check_on_this_machine(ConfigReport* report) {
  const Config& c = report->config;
  check_cpus("threads.camera", c.threads.camera, report);
  check_cpus("threads.imu", c.threads.imu, report);
  check_cpus("threads.tracker", c.threads.tracker, report);
  check_cpus("threads.mapper", c.threads.mapper, report);
  check_cpus("threads.detector", c.threads.detector, report);
  check_cpus("threads.link", c.threads.link, report);
  const int slots = c.pipeline.frame_slots;
  if (slots != 0 && slots < odometry_frame_slots_min()) {
    report->mistake("pipeline.frame_slots", std::to_string(slots) + " are too few to fly with; 0 or at least " +
                                                std::to_string(odometry_frame_slots_min()) + " are allowed");
  }
  check_scenario(report);
  check_devices(report);
  if (c.detector.enabled) {
    check_model_files(c.detector,
                      [report](const std::string& key, const std::string& why) { report->mistake(key, why); });
  }
  check_state_folder(report);
  report->sort();
}

namespace {

/// Poses of pictures that are not taken now must not reach an autopilot by oversight.
void check_simulated(ConfigReport* report) {
  using Source = Config::Camera::Source;
  const Config& c = report->config;
  const bool replayed = c.camera.source == Source::kReplay;
  if (replayed && c.camera.sequence.empty()) report->mistake("camera.sequence", "\"replay\" needs the folder of one");
  if ((!replayed && c.camera.source != Source::kSim) || c.camera.allow_simulated) return;
  // vcan is none that an aircraft hangs on.
  const bool real_bus = (c.can.bus.starts_with("socketcan:") && !c.can.bus.starts_with("socketcan:v")) ||
                        c.link.mavlink.starts_with("serial:");
  if (!real_bus) return;
  report->mistake("camera.source", std::string(replayed ? "\"replay\"" : "\"sim\"") +
                                       " on a real bus: an autopilot would fly by pictures that are not taken now; "
                                       "camera.allow_simulated = true allows it, for the bench");
}

}  // namespace

void check_for_daemon(ConfigReport* report) {
  check_on_this_machine(report);
  if (report->config.camera.source == Config::Camera::Source::kNone)
    report->mistake("camera.source",
                    "a daemon needs a camera; \"v4l2\", \"libcamera\", \"replay\" or \"sim\" is allowed");
  check_simulated(report);
  if (report->config.link.bench_metric) {
    report->mistake("link.bench_metric",
                    "in flight an autopilot would take lengths of unknown scale for metres; only false "
                    "is allowed");
  }
  report->sort();
}

}  // namespace godwit::app
