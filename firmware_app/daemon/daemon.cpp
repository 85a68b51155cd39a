#include "firmware_app/daemon/daemon.h"

#include <algorithm>
#include <array>
#include <fmt/format.h>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "firmware_app/autopilot/link_runner.h"
#include "firmware_app/config/version.h"
#include "firmware_app/daemon/daemon_camera.h"
#include "firmware_app/daemon/daemon_imu.h"
#include "firmware_app/daemon/end_guard.h"
#include "firmware_app/daemon/watchdog.h"
#include "firmware_app/flight/assembly.h"
#include "firmware_app/flight/live_plan.h"
#include "firmware_app/flight/pipeline_plan.h"
#include "firmware_app/flight/recorder_plan.h"
#include "firmware_app/output/event_line.h"
#include "firmware_app/output/line_log.h"
#include "firmware_app/program/exit_code.h"
#include "firmware_app/program/program.h"
#include "hal/machine/machine_state.h"
#include "hal/machine/service_manager.h"
#include "hal/rt/process_end.h"

namespace godwit::app {
namespace {

void say(const std::string& line) {
  error_log().put("godwitd: " + line);
}

/// Of the disc, at the end.
constexpr rt::TimeNs kEventPatienceNs = 2 * rt::kNsPerSecond;

int give_up(const std::string& line) {
  say(line);
  return kExitFailed;
}

/// How often the flight log is told of the bus.
constexpr rt::TimeNs kBusNs = rt::kNsPerSecond;

/// Tells what changes; frame after frame is for the flight log and the event recorder, which may be null (as the
/// link), and for whoever looks.
class Journal final : public FrameSink {
 public:
  Journal(const hal::ServiceManager& manager, bool locks_memory, std::string memory_refused, FlightLog* log,
          EventRecorder* recorder, Live* live, const LinkRunner* autopilot)
      : manager_(manager),
        locks_memory_(locks_memory),
        memory_refused_(std::move(memory_refused)),
        log_(log),
        recorder_(recorder),
        live_(live),
        autopilot_(autopilot) {}

  void started(const std::vector<std::string>& refused) override {
    const std::string warning = privilege_warning(memory_refused_, refused);
    if (!warning.empty()) say("warning: " + warning);
    say(!warning.empty() ? "flying, not armed"
        : locks_memory_  ? "armed: memory is locked, all threads run as planned"
                         : "flying, not armed: threads.lock_memory is off");
    manager_.ready();
  }
  rt::Result<void> take(const FrameRecord& record) override {
    clock_.heard(record.t_capture_ns);
    if (record.tracked) ++tracked_;
    if (log_ != nullptr) log_->frame(record);
    if (recorder_ != nullptr) recorder_->frame(record);
    live_->status.frame(record);
    live_->track.frame(record);
    return {};
  }
  void reading(const hal::ImuSample& sample) override {
    if (log_ != nullptr) log_->reading(sample);
  }
  void turn(rt::TimeNs now_ns) override {
    if (log_ == nullptr || autopilot_ == nullptr || now_ns < t_bus_due_ns_) return;
    t_bus_due_ns_ = now_ns + kBusNs;
    log_->bus(autopilot_->status());
  }
  void detection(const FoundBoxes& found) override {
    if (log_ != nullptr) log_->detection(found);
  }
  void event(const rt::LogEntry& e) override {
    clock_.heard(e.t_ns);
    if (log_ != nullptr) log_->event(e);
    const std::string line = event_line(e, clock_.first_ns());
    live_->status.event(e, line);
    say(line);
  }
  std::uint64_t tracked() const { return tracked_; }

 private:
  const hal::ServiceManager& manager_;
  const bool locks_memory_;
  const std::string memory_refused_;
  FlightLog* const log_;
  EventRecorder* const recorder_;
  Live* const live_;
  const LinkRunner* const autopilot_;
  rt::TimeNs t_bus_due_ns_ = 0;
  EventClock clock_;
  std::uint64_t tracked_ = 0;
};

void tell(const PipelineCounters& c, std::uint64_t tracked, bool detector) {
  say(fmt::format("{} frames, {} tracked, {} repeated, {} bad, {} dropped, {} late; {} rungs down, {} up, now {}",
                  c.due, tracked, c.repeated, c.bad, c.dropped_slots + c.dropped_late, c.scheduler.slips,
                  c.scheduler.steps_down, c.scheduler.steps_up, rung_name(c.rung)));
  if (detector) {
    const SchedulerCounters& s = c.scheduler;
    say(fmt::format("detector: {} detections, {} failed, {} late, {} times hung", s.detections, s.detections_failed,
                    s.detections_late, s.detector_stuck));
  }
  if (c.imu) {
    say(fmt::format("IMU: {} samples, {} saturated, {} gaps, {} faults, {} implausible, {} dropped, {} silences",
                    c.imu->samples, c.imu->saturated, c.imu->gaps, c.imu->faults, c.imu->implausible, c.imu->dropped,
                    c.imu->silences));
  }
  for (const ThreadReport& t : c.threads) {
    say(fmt::format("thread {}: {} minor and {} major page faults, {} kB of stack", t.name, t.faults.minor,
                    t.faults.major, t.stack_used / 1024));
  }
}

using Mounting = std::optional<std::array<double, 16>>;

Mounting mounting_of(const DaemonCamera& camera) {
  return camera.calibration() ? camera.calibration()->T_body_cam : std::nullopt;
}

/// While there is no camera: ready all the same, and the node says that it has failed once it should have been there.
class WithoutCamera {
 public:
  WithoutCamera(const hal::ServiceManager& manager, LinkRunner* autopilot) : manager_(manager), autopilot_(autopilot) {}
  void operator()() {
    const rt::TimeNs now_ns = rt::monotonic_now_ns();
    if (t_begin_ns_ == 0) {
      t_begin_ns_ = now_ns;
      manager_.ready();
    }
    if (autopilot_ != nullptr && now_ns - t_begin_ns_ > kCameraDueNs) autopilot_->no_picture(now_ns, 0);
  }

 private:
  static constexpr rt::TimeNs kCameraDueNs = 3 * rt::kNsPerSecond;
  const hal::ServiceManager& manager_;
  LinkRunner* const autopilot_;
  rt::TimeNs t_begin_ns_ = 0;
};

void tell(const FlightLogReport& r) {
  say(fmt::format("flight log: {} kB in {} files, {} messages dropped{}", r.written_bytes / 1000, r.files, r.dropped,
                  r.trouble.empty() ? "" : "; " + r.trouble));
}

/// Without an inertial sensor the autopilot's attitude tells the vertical, where it is known how the camera sits on it.
bool flown_by_attitude(const Config& config, const hal::CameraCalibration& calibration, const LinkRunner* autopilot) {
  if (config.imu.flown_by() || !config.aids.attitude || autopilot == nullptr) return false;
  if (inertial_mounting(config, calibration)) return true;
  say("aids: not used, and no pose will be in metres: neither the calibration nor link.T_body_cam says where the "
      "camera "
      "sits on the body");
  return false;
}

/// Camera, networks and threads, until the end. Returns an ExitCode.
int fly(const Config& config, DaemonCamera* camera, const Mounting& mounting, LinkRunner* autopilot,
        rt::Heartbeats* heartbeats, const hal::ServiceManager& manager, const std::function<void(const char*)>& abandon,
        const std::atomic<bool>& stop, const std::atomic<bool>& ending) {
  const auto opened =
      camera->open(config.camera, config.threads.camera, say, WithoutCamera(manager, autopilot), ending);
  if (ending.load(std::memory_order_relaxed)) return kExitDone;
  if (!opened) return give_up(opened.error().message);
  if (autopilot != nullptr && config.link.T_body_cam.empty() && mounting_of(*camera) != mounting) {
    say("the camera's calibration says how it is mounted: starting anew with that");
    return kExitRestart;
  }
  const hal::CameraCalibration& calibration = *camera->calibration();
  // The networks run once here, so that the first picture in flight is not the slow one.
  AssemblyPlan plan;
  plan.inertial = config.imu.flown_by();
  auto imu_errors = daemon_imu_errors(config, *camera);
  if (!imu_errors) return give_up(imu_errors.error().message);
  plan.imu_errors = imu_errors.value();
  plan.aided = flown_by_attitude(config, calibration, autopilot);
  const std::string events = events_folder(config);
  plan.onlooker = !events.empty();
  const std::unique_ptr<LivePicture> picture = live_picture(config, calibration.width, calibration.height);
  plan.view = picture.get();
  auto assembled = assemble(config, calibration, plan);
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
  auto imu = open_daemon_imu(config, *camera, say);
  if (!imu) return give_up(imu.error().message);
  if (imu.value() != nullptr) {
    say(config.imu.enabled ? "IMU: flown by; poses are in metres, z up, once it has shown both"
                           : "IMU: watched, not flown by (imu.enabled is false)");
  }
  options.imu = imu.value().get();
  options.heartbeats = heartbeats;
  options.abandon = abandon;
  options.tap = autopilot;
  if (autopilot != nullptr) options.aids = autopilot->aids();
  // The link's own flag is raised by its thread, which may hang.
  options.also_stop = &stop;
  // Before memory is locked: its thread and its buffers belong to what is there.
  const std::unique_ptr<FlightLog> flight_log = begin_flight_log(config, say);
  const std::unique_ptr<EventRecorder> recorder =
      begin_recorder(config, events, calibration, parts.pool.get(), say, abandon);
  if (recorder != nullptr) options.onlooker = recorder->onlooker();
  const hal::MachineMonitor live_machine;  // one thread reads each
  const auto quality = [autopilot] { return autopilot->quality(); };
  Live live{LiveStatus({version_words(version()), autopilot != nullptr ? std::function<int()>(quality) : nullptr,
                        &live_machine}),
            {}};
  const std::unique_ptr<LiveServer> server = begin_live(config, &live, picture.get(), say, abandon);
  Journal journal(manager, config.threads.lock_memory, arm_memory(config), flight_log.get(), recorder.get(), &live,
                  autopilot);
  const auto run = run_pipeline(camera->camera(), parts.stage.get(), parts.pool.get(), options, &journal, ending);
  rt::begin_process_end();  // whoever wanted it
  if (!run) return give_up(run.error().message);
  PipelineCounters counters = run.value();
  if (autopilot != nullptr) {
    autopilot->finish();
    counters.threads.push_back(autopilot->thread_report());
  }
  tell(counters, journal.tracked(), parts.dynamic != nullptr);
  if (flight_log != nullptr) tell(flight_log->finish(rt::kNsPerSecond));
  if (recorder != nullptr) say("event recorder: " + recorder_words(recorder->finish(kEventPatienceNs)));
  return kExitDone;
}

}  // namespace

int run_daemon(const Config& config, const std::atomic<bool>& stop) {
  say("godwitd " + version_words(version()));
  const hal::ServiceManager manager;
  EndGuard guard(stop, config.threads.link);
  if (!guard.trouble().empty()) say("warning: gw-end: " + guard.trouble());
  // Outlives link and pipeline.
  rt::Heartbeats heartbeats;
  const Watchdog watchdog(manager, heartbeats, config.threads.link);
  if (!watchdog.trouble().empty()) say("warning: watchdog: " + watchdog.trouble());

  auto found = DaemonCamera::find(config.camera, imu_goes_with_camera(config));
  if (!found) return give_up(found.error().message);
  DaemonCamera& camera = found.value();
  const auto mounting = mounting_of(camera);

  const auto abandon = [&guard](const char* thread) { guard.abandon(thread); };
  const auto log = [](LinkLogLevel level, const std::string& text) {
    say((level == LinkLogLevel::kWarning ? "warning: " : "") + text);
  };
  // The node is on the bus before camera and networks are there.
  auto link = start_link(config, mounting, log, stop, nullptr, &heartbeats, abandon, true, true);
  if (!link) {
    say(link.error().message);
    return kExitRefused;
  }
  LinkRunner* const autopilot = link.value().get();
  if (autopilot != nullptr)
    guard.watch({[autopilot] { return autopilot->stop().load(std::memory_order_relaxed); },
                 [autopilot] { return autopilot->restart_due(); }});
  const auto unwatch = [&guard](const LinkRunner*) { guard.watch({}); };
  const std::unique_ptr<const LinkRunner, decltype(unwatch)> watched(autopilot, unwatch);
  const std::atomic<bool>& ending = autopilot != nullptr ? autopilot->stop() : stop;
  const int code = fly(config, &camera, mounting, autopilot, &heartbeats, manager, abandon, stop, ending);
  manager.stopping();
  if (autopilot == nullptr) return code;
  for (const std::string& line : link_report(autopilot->finish())) say("link: " + line);
  for (const std::string& line : autopilot->aid_words()) say("link: " + line);
  if (code != kExitDone || !autopilot->restart_due()) return code;
  say("restart asked for over the bus");
  return kExitRestart;
}

}  // namespace godwit::app
