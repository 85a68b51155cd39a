#include "firmware_app/daemon/daemon.h"

#include <fmt/format.h>
#include <memory>
#include <string>

#include "firmware_app/autopilot/link_runner.h"
#include "firmware_app/flight/assembly.h"
#include "firmware_app/flight/devices.h"
#include "firmware_app/flight/pipeline_plan.h"
#include "firmware_app/flight/scenario_folder.h"
#include "firmware_app/output/event_line.h"
#include "firmware_app/output/line_log.h"
#include "firmware_app/program/exit_code.h"
#include "firmware_app/program/program.h"
#include "firmware_app/sim/flight_calibration.h"
#include "firmware_app/sim/looped_pictures.h"
#include "hal/machine/machine_state.h"

namespace godwit::app {
namespace {

void say(const std::string& line) {
  error_log().put("godwitd: " + line);
}

int give_up(const std::string& line) {
  say(line);
  return kExitFailed;
}

/// Tells what changes; frame after frame is for the flight log.
class Journal final : public FrameSink {
 public:
  Journal(bool locks_memory, std::string memory_refused)
      : locks_memory_(locks_memory), memory_refused_(std::move(memory_refused)) {}

  void started(const std::vector<std::string>& refused) override {
    const std::string warning = privilege_warning(memory_refused_, refused);
    if (!warning.empty()) say("warning: " + warning);
    say(!warning.empty() ? "flying, not armed"
        : locks_memory_  ? "armed: memory is locked, all threads run as planned"
                         : "flying, not armed: threads.lock_memory is off");
  }
  rt::Result<void> take(const FrameRecord& record) override {
    clock_.heard(record.t_capture_ns);
    if (record.tracked) ++tracked_;
    return {};
  }
  void event(const rt::LogEntry& e) override {
    clock_.heard(e.t_ns);
    say(event_line(e, clock_.first_ns()));
  }
  std::uint64_t tracked() const { return tracked_; }

 private:
  const bool locks_memory_;
  const std::string memory_refused_;
  EventClock clock_;
  std::uint64_t tracked_ = 0;
};

/// The camera of the configuration, with its calibration.
struct Source {
  std::unique_ptr<sim::Flight> flight;
  std::unique_ptr<hal::Camera> camera;
  hal::CameraCalibration calibration;
};

rt::Result<Source> open_device(const Config::Camera& config) {
  auto opened = open_camera(config, say);
  if (!opened) return opened.error();
  Source out;
  out.camera = std::move(opened.value().camera);
  out.calibration = opened.value().calibration;
  return out;
}

rt::Result<Source> open_sim(const Config::Camera& config, const std::atomic<bool>& stop) {
  const auto scenario = sim::find_scenario(config.scenario, scenario_folder(config.scenarios));
  if (!scenario) return scenario.error();
  Source out;
  out.flight = std::make_unique<sim::Flight>(scenario.value(), config.seed);
  out.calibration = calibration_of(*out.flight);
  const auto rendered = out.flight->camera(0);
  LoopedPictures::Options options;
  options.interval_ns = static_cast<rt::TimeNs>(1e9 / out.calibration.fps);
  say(fmt::format("rendering {} pictures of {}, seed {}", config.pictures, config.scenario, config.seed));
  auto camera = LoopedPictures::record(rendered.get(), config.pictures, options, stop);
  if (!camera) return camera.error();
  out.camera = std::move(camera).value();
  return out;
}

void tell(const PipelineCounters& c, std::uint64_t tracked, bool detector) {
  say(fmt::format("{} frames, {} tracked, {} bad, {} dropped, {} late; {} rungs down, {} up, now {}", c.due, tracked,
                  c.bad, c.dropped_slots + c.dropped_late, c.scheduler.slips, c.scheduler.steps_down,
                  c.scheduler.steps_up, rung_name(c.rung)));
  if (detector) {
    const SchedulerCounters& s = c.scheduler;
    say(fmt::format("detector: {} detections, {} failed, {} late, {} times hung", s.detections, s.detections_failed,
                    s.detections_late, s.detector_stuck));
  }
  if (c.imu) {
    say(fmt::format("IMU: {} samples, {} gaps, {} faults, {} implausible, {} dropped, {} silences", c.imu->samples,
                    c.imu->gaps, c.imu->faults, c.imu->implausible, c.imu->dropped, c.imu->silences));
  }
  for (const ThreadReport& t : c.threads) {
    say(fmt::format("thread {}: {} minor and {} major page faults, {} kB of stack", t.name, t.faults.minor,
                    t.faults.major, t.stack_used / 1024));
  }
}

}  // namespace

int run_daemon(const Config& config, const std::atomic<bool>& stop) {
  const bool simulated = config.camera.source == Config::Camera::Source::kSim;
  auto source = simulated ? open_sim(config.camera, stop) : open_device(config.camera);
  if (stop.load(std::memory_order_relaxed)) return kExitDone;
  if (!source) return give_up(source.error().message);
  const hal::CameraCalibration& calibration = source.value().calibration;
  // The networks run once here, so that the first picture in flight is not the slow one.
  auto assembled = assemble(config, calibration, {});
  if (!assembled) {
    say(assembled.error().message);
    return kExitRefused;
  }
  const Assembly& parts = assembled.value();
  if (parts.dynamic != nullptr && !parts.dynamic->warning().empty()) say("warning: " + parts.dynamic->warning());

  const hal::MachineMonitor machine;
  say(machine.zones().empty() ? "no thermal zone tells this machine's temperature"
                              : "temperature: the hottest of " + machine.zones());
  PipelineOptions options;
  options.newest_frame = true;
  options.machine = &machine;
  parts.plan_detector(&options);
  plan_pipeline(config, calibration.fps, &options);
  auto imu = open_imu(config.imu, say);
  if (!imu) return give_up(imu.error().message);
  options.imu = imu.value().get();
  const auto log = [](LinkLogLevel level, const std::string& text) {
    say((level == LinkLogLevel::kWarning ? "warning: " : "") + text);
  };
  // Both outlive link and pipeline.
  rt::Heartbeats heartbeats;
  const LinkRunner* restarts = nullptr;
  const auto abandon = [&restarts](const char* thread) {
    end_without("godwitd", thread, restarts != nullptr && restarts->restart_due() ? kExitRestart : kExitFailed);
  };
  options.heartbeats = &heartbeats;
  options.abandon = abandon;
  auto link = start_link(config, calibration.T_body_cam, log, stop, nullptr, &heartbeats, abandon);
  if (!link) {
    say(link.error().message);
    return kExitRefused;
  }
  LinkRunner* const autopilot = link.value().get();
  restarts = autopilot;
  options.tap = autopilot;
  // The link's own flag is raised by its thread, which may hang.
  options.also_stop = &stop;
  Journal journal(config.threads.lock_memory, arm_memory(config));
  const auto run = run_pipeline(source.value().camera.get(), parts.stage.get(), parts.pool.get(), options, &journal,
                                autopilot != nullptr ? autopilot->stop() : stop);
  if (!run) return give_up(run.error().message);
  PipelineCounters counters = run.value();
  if (autopilot != nullptr) {
    autopilot->finish();
    counters.threads.push_back(autopilot->thread_report());
  }
  tell(counters, journal.tracked(), parts.dynamic != nullptr);
  if (autopilot == nullptr) return kExitDone;
  for (const std::string& line : link_report(autopilot->finish())) say("link: " + line);
  if (autopilot->restart_due()) {
    say("restart asked for over the bus");
    return kExitRestart;
  }
  return kExitDone;
}

}  // namespace godwit::app
