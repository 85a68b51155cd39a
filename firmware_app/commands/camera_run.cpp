#include "firmware_app/commands/camera_run.h"

#include <cmath>
#include <fmt/format.h>

#include "firmware_app/autopilot/link_runner.h"
#include "firmware_app/config/version.h"
#include "firmware_app/flight/assembly.h"
#include "firmware_app/flight/live_plan.h"
#include "firmware_app/flight/pipeline_plan.h"
#include "firmware_app/flight/recorder_plan.h"
#include "firmware_app/output/event_line.h"
#include "firmware_app/output/flown_log.h"
#include "firmware_app/output/line_log.h"
#include "firmware_app/output/progress_bar.h"
#include "firmware_app/output/run_writer.h"
#include "firmware_app/output/view_writer.h"
#include "firmware_app/pipeline/pipeline.h"
#include "firmware_app/program/exit_code.h"
#include "firmware_app/program/program.h"

namespace godwit::app {
namespace {

/// Nobody flies on meanwhile.
constexpr rt::TimeNs kEventPatienceNs = 60 * rt::kNsPerSecond;

void say(const std::string& line) {
  error_log().put("godwit: " + line);
}

/// Passes the frames on, shows how far the run is and tells what happens.
class ShowingSink final : public FrameSink {
 public:
  ShowingSink(FrameSink* next, FrameSink* beside, EventRecorder* recorder, FlightLog* log, ProgressBar* bar,
              const LinkRunner* autopilot, std::string memory_refused)
      : next_(next),
        beside_(beside),
        recorder_(recorder),
        log_(log),
        bar_(bar),
        autopilot_(autopilot),
        memory_refused_(std::move(memory_refused)) {}
  rt::Result<void> take(const FrameRecord& record) override {
    clock_.heard(record.t_capture_ns);
    bar_->show(++done_, vo::state_name(record.state));
    if (recorder_ != nullptr) recorder_->frame(record);
    if (log_ != nullptr) log_->frame(record);
    if (beside_ != nullptr) {
      if (auto taken = beside_->take(record); !taken) return taken;
    }
    return next_->take(record);
  }
  void started(const std::vector<std::string>& refused) override {
    const std::string warning = privilege_warning(memory_refused_, refused);
    if (!warning.empty()) say("warning: " + warning);
  }
  void reading(const hal::ImuSample& sample) override {
    if (log_ != nullptr) log_->reading(sample);
  }
  void turn(rt::TimeNs now_ns) override {
    if (log_ == nullptr || autopilot_ == nullptr || now_ns < t_bus_due_ns_) return;
    t_bus_due_ns_ = now_ns + rt::kNsPerSecond;
    log_->bus(autopilot_->status());
  }
  void detection(const FoundBoxes& found) override {
    if (log_ != nullptr) log_->detection(found);
  }
  void event(const rt::LogEntry& entry) override {
    clock_.heard(entry.t_ns);
    if (log_ != nullptr) log_->event(entry);
    bar_->make_way();
    say(event_line(entry, clock_.first_ns()));
    next_->event(entry);
  }

 private:
  FrameSink* next_;
  FrameSink* beside_;
  EventRecorder* recorder_;
  FlightLog* log_;
  ProgressBar* bar_;
  const LinkRunner* autopilot_;
  rt::TimeNs t_bus_due_ns_ = 0;
  const std::string memory_refused_;
  std::int64_t done_ = 0;
  EventClock clock_;
};

void tell(const RunWriter& writer, const std::string& folder, bool inertial) {
  const RunSummary s = writer.summary();
  const std::uint64_t lost = s.counters.due - s.counters.processed;
  fmt::print("{} frames, {} tracked ({:.2f} %), {} map{}\n", s.counters.due, s.tracked, 100.0 * s.tracked_share, s.maps,
             s.maps == 1 ? "" : "s");
  if (s.first_pose_frames >= 0) {
    fmt::print("first pose after {} frames ({:.0f} ms); from there on {:.2f} % tracked\n", s.first_pose_frames,
               s.first_pose_ms, 100.0 * s.tracked_share_after_first);
    fmt::print(
        "tracking a frame: median {:.2f} ms, p95 {:.2f}, p99 {:.2f}, max {:.2f}; processor time with mapping: "
        "mean {:.2f} ms\n",
        s.ms.median, s.ms.p95, s.ms.p99, s.ms.max, s.proc_cpu_ms.mean);
    fmt::print("rates: {:.1f} pictures and {:.1f} poses a second of flight\n", s.pictures_hz, s.poses_hz);
    if (s.age_ms.max > 0) {
      fmt::print("from capture to pose: median {:.2f} ms, p95 {:.2f}, p99 {:.2f}, max {:.2f}\n", s.age_ms.median,
                 s.age_ms.p95, s.age_ms.p99, s.age_ms.max);
    }
  } else {
    fmt::print("no pose was found\n");
  }
  if (const auto& imu = writer.pipeline().imu) {
    fmt::print("IMU: {} samples, {} gaps, {} dropped, {} silences{}{}\n", imu->samples, imu->gaps, imu->dropped,
               imu->silences, imu->saturated > 0 ? fmt::format(", {} at the end of the range", imu->saturated) : "",
               inertial ? "" : "; they were watched, not used");
  }
  if (s.aided_log_sigma > 0) {
    fmt::print(
        "scale {} IMU: known to {:.1f} %, by range {:.0f} %, baro {:.0f} %, gnss {:.0f} %, starting height {:.0f} %\n",
        inertial ? "beside the" : "without an", 100 * s.aided_log_sigma, 100 * s.aid_share[0], 100 * s.aid_share[1],
        100 * s.aid_share[2], 100 * s.aid_share[3]);
  }
  if (s.earth.fixes > 0) {
    fmt::print("north by satellites: {}{}; of {} fixes {} used, {} refused\n", north_word(s.earth),
               s.earth.known ? fmt::format(", the frame's x axis heads {:.1f} degrees from north, sigma {:.1f}",
                                           std::fmod(450 - s.earth.heading * 180 / M_PI, 360.0),
                                           s.earth.heading_sigma * 180 / M_PI)
                             : "",
               s.earth.fixes, s.earth.fixes_used, s.earth.fixes_refused);
  }
  if (lost > 0) {
    fmt::print("{} pictures were not flown: {} bad, {} dropped\n", lost, s.counters.bad,
               s.counters.dropped_slots + s.counters.dropped_late);
    for (const std::string& reason : writer.bad_reasons()) fmt::print("  {}\n", reason);
    if (lost > writer.bad_reasons().size()) fmt::print("  ... (all are in frames.csv)\n");
  }
  fmt::print("peak memory {:.0f} MB; written to {}: trajectory.tum frames.csv pose.csv summary.json\n",
             peak_memory_mb(), folder);
}

/// What is to be flown again, as far as it is asked for. Error: there is no such log, or it has a gap before that.
rt::Result<FlownLog> flown_log(const CameraRunPlan& plan) {
  auto read = read_flown_log(plan.as_flown);
  if (!read) return read;
  FlownLog& log = read.value();
  if (plan.frames > 0) keep_first(plan.frames, &log);
  if (log.gap.empty()) return read;
  const std::string whole =
      log.frames.empty() ? "" : fmt::format("; --frames {} flies what is", log.frames.back().sequence + 1);
  return rt::Error{fmt::format("{}: the flight was not recorded whole: {}{}", plan.as_flown, log.gap, whole)};
}

std::string log_words(const FlightLogReport& r) {
  return fmt::format("{} kB in {} file{}, {} messages dropped{}", r.written_bytes / 1000, r.files,
                     r.files == 1 ? "" : "s", r.dropped, r.trouble.empty() ? "" : "; " + r.trouble);
}

int tell_as_flown(const AsFlownCounters& c) {
  if (c.unequal > 0) {
    return failed(
        fmt::format("as flown: {} frames, from picture {} on, are not those of the log to the bit: another "
                    "machine, program or configuration",
                    c.unequal, c.first_unequal));
  }
  fmt::print("as flown: all {} poses of the log are the same to the bit\n", c.poses);
  return kExitDone;
}

}  // namespace

int refuse(const std::string& message) {
  say(message);
  return kExitRefused;
}

int failed(const std::string& message) {
  say(message);
  return kExitFailed;
}

int run_camera(hal::Camera* camera, const hal::CameraCalibration& calibration, const Config& config,
               const CameraRunPlan& plan, const std::atomic<bool>& stop) {
  std::optional<ViewWriter> view;
  if (!plan.view.empty()) {
    auto opened = ViewWriter::open(plan.view, plan.view_every);
    if (!opened) return refuse("--view: " + opened.error().message);
    view.emplace(std::move(opened).value());
  }
  std::optional<FlownLog> flown;
  if (!plan.as_flown.empty()) {
    auto read = flown_log(plan);
    if (!read) return refuse("--as-flown: " + read.error().message);
    flown.emplace(std::move(read).value());
  }
  AssemblyPlan parts_plan;
  parts_plan.calibration_name = plan.calibration_name;
  parts_plan.sequential = plan.sequential;
  parts_plan.masks = plan.masks;
  parts_plan.view = view ? &*view : nullptr;
  parts_plan.inertial = plan.inertial;
  parts_plan.aided = plan.aided;
  parts_plan.imu_errors = plan.imu_errors;
  parts_plan.gyro_helps = plan.gyro_helps;
  parts_plan.onlooker = !plan.events.empty();
  auto assembled = assemble(config, calibration, parts_plan);
  if (!assembled) return refuse(assembled.error().message);
  const Assembly& parts = assembled.value();
  if (parts.dynamic != nullptr && !parts.dynamic->warning().empty()) say("warning: " + parts.dynamic->warning());

  PipelineOptions pipeline;
  pipeline.sequential = plan.sequential;
  pipeline.sequential_detection_ns = config.pipeline.detection_ms * rt::kNsPerMs;
  pipeline.as_flown = flown ? &*flown : nullptr;
  pipeline.newest_frame = plan.pace == "real";
  parts.plan_detector(&pipeline);
  pipeline.imu = plan.imu;
  pipeline.aids = plan.aids;
  const auto log = [](LinkLogLevel level, const std::string& text) {
    say((level == LinkLogLevel::kWarning ? "warning: " : "") + text);
  };
  rt::Heartbeats heartbeats;
  const auto abandon = [](const char* thread) { end_without("godwit", thread, kExitFailed); };
  pipeline.heartbeats = &heartbeats;
  pipeline.abandon = abandon;
  pipeline.also_stop = &stop;
  auto link = start_link(config, calibration.T_body_cam, log, stop, nullptr, &heartbeats, abandon);
  if (!link) return refuse(link.error().message);
  LinkRunner* const autopilot = link.value().get();
  pipeline.tap = autopilot;
  const hal::MachineMonitor machine;
  pipeline.machine = &machine;
  plan_pipeline(config, calibration.fps, &pipeline);
  std::unique_ptr<EventRecorder> recorder;
  if (!plan.events.empty()) {
    const bool live = pipeline.newest_frame;  // else it waits for the disc, and is waited for
    auto started = start_recorder(config, plan.events, calibration, parts.pool.get(), live, say,
                                  live ? pipeline.abandon : nullptr);
    if (!started) return refuse(started.error().message);
    recorder = std::move(started).value();
    pipeline.onlooker = recorder->onlooker();
    say("event recorder: " + recorder->description());
  }
  RunWriter writer;
  auto opened = writer.open(plan.out, pipeline.newest_frame);
  if (!opened) return failed(opened.error().message);
  const std::unique_ptr<FlightLog> flight_log = plan.log.empty() ? nullptr : begin_flight_log_in(plan.log, config);
  rt::Result<PipelineCounters> run = rt::Error{""};
  {
    ProgressBar bar(plan.total);
    ShowingSink sink(&writer, plan.beside, recorder.get(), flight_log.get(), &bar, autopilot, arm_memory(config));
    run = run_pipeline(camera, parts.stage.get(), parts.pool.get(), pipeline, &sink,
                       autopilot != nullptr ? autopilot->stop() : stop);
  }
  if (recorder != nullptr) say("event recorder: " + recorder_words(recorder->finish(kEventPatienceNs)));
  if (flight_log != nullptr) say("flight log: " + log_words(flight_log->finish(kEventPatienceNs)));
  if (!run) return failed(run.error().message);
  if (stop.load(std::memory_order_relaxed)) {
    say("interrupted; nothing was written");
    return kExitInterrupted;
  }
  if (autopilot != nullptr && autopilot->restart_due()) {
    say("restart asked for over the bus; nothing was written");
    return kExitRestart;
  }
  RunDescription description{version_words(version()),
                             plan.source,
                             flown             ? "as_flown"
                             : plan.sequential ? "sequential"
                                               : "threads",
                             plan.pace,
                             plan.start,
                             ""};
  if (autopilot != nullptr) description.link = link_report_json(autopilot->finish());
  writer.set_pipeline(run.value());
  auto finished = writer.finish(description);
  if (!finished) return failed(finished.error().message);
  tell(writer, plan.out, plan.inertial);
  if (view) {
    if (!view->error().empty()) return failed("--view: " + view->error());
    fmt::print("{} pictures of what was seen in {}\n", view->written(), plan.view);
  }
  if (autopilot != nullptr) {
    for (const std::string& line : link_report(autopilot->finish())) fmt::print("link: {}\n", line);
  }
  return flown ? tell_as_flown(run.value().as_flown) : kExitDone;
}

}  // namespace godwit::app
