#include "benchmarks/latency/flight.h"

#include <algorithm>
#include <filesystem>
#include <fmt/format.h>
#include <fstream>
#include <malloc.h>

#include "benchmarks/latency/thread_watch.h"
#include "benchmarks/latency/watched_parts.h"
#include "firmware_app/autopilot/link_runner.h"
#include "firmware_app/config/version.h"
#include "firmware_app/flight/assembly.h"
#include "firmware_app/flight/devices.h"
#include "firmware_app/flight/live_plan.h"
#include "firmware_app/flight/pipeline_plan.h"
#include "firmware_app/flight/recorder_plan.h"
#include "firmware_app/flight/scenario_folder.h"
#include "firmware_app/output/event_line.h"
#include "firmware_app/output/statistics.h"
#include "firmware_app/sim/flight_calibration.h"
#include "firmware_app/sim/picture_memory.h"
#include "hal/camera/replay/replay_camera.h"
#include "hal/sim/flight/flight.h"

namespace godwit::bench {
namespace {

constexpr double kDefaultFps = 30;
constexpr rt::TimeNs kLookPeriodNs = rt::kNsPerSecond;

double line_of_status_mb(const char* key) {
  std::ifstream status("/proc/self/status");
  std::string word;
  double kb = 0;
  while (status >> word) {
    if (word == key) {
      status >> kb;
      break;
    }
  }
  return kb * 1024 / 1e6;
}

std::int64_t flown_pictures(const Options& o, double fps) {
  return std::max<std::int64_t>(2, static_cast<std::int64_t>(o.seconds * fps));
}

void say(const std::string& words) {
  fmt::print(stderr, "godwit-latency: {}\n", words);
}

/// What the daemon keeps and shows of a flight beside the poses, as the configuration wants it.
class Watchers {
 public:
  /// Before memory is locked. picture: as the odometry shows it; it and the pool outlive this.
  rt::Result<void> start(const app::Config& config, const hal::CameraCalibration& calibration, rt::FramePool* pool,
                         app::LivePicture* picture, app::PipelineOptions* options) {
    wanted_ = true;
    log_ = app::begin_flight_log(config, say);
    if (const std::string events = app::events_folder(config); !events.empty()) {
      auto started = app::start_recorder(config, events, calibration, pool, true, say, nullptr);
      if (!started) return started.error();
      recorder_ = std::move(started).value();
      options->onlooker = recorder_->onlooker();
    }
    server_ = app::begin_live(config, &live_, picture, say, nullptr);
    return {};
  }
  void frame(const app::FrameRecord& record) {
    if (!wanted_) return;
    if (log_ != nullptr) log_->frame(record);
    if (recorder_ != nullptr) recorder_->frame(record);
    live_.status.frame(record);
    live_.track.frame(record);
  }
  void reading(const hal::ImuSample& sample) {
    if (log_ != nullptr) log_->reading(sample);
  }

 private:
  bool wanted_ = false;
  std::unique_ptr<app::FlightLog> log_;
  std::unique_ptr<app::EventRecorder> recorder_;
  app::Live live_{app::LiveStatus({app::version_words(app::version()), {}, nullptr}), {}};
  std::unique_ptr<app::LiveServer> server_;
};

/// Collects what the flight brings; the thread that runs the pipeline. delivery_ns: what a simulated camera takes to
/// deliver; negative: a live one, whose delivery is measured.
class Collector final : public app::FrameSink {
 public:
  Collector(FlightFigures* figures, rt::TimeNs delivery_ns, double deadline_ms, link::DepartureRing* departures,
            Watchers* watchers)
      : figures_(figures),
        delivery_ns_(delivery_ns),
        deadline_ms_(deadline_ms),
        departures_(departures),
        watchers_(watchers) {}

  void event(const rt::LogEntry& e) override {
    if (delivery_ns_ < 0) fmt::print(stderr, "godwit-latency: {}\n", app::event_line(e, e.t_ns));
  }

  void reading(const hal::ImuSample& sample) override { watchers_->reading(sample); }
  void started(const std::vector<std::string>& refused) override {
    figures_->refused = app::privilege_warning(figures_->refused, refused);
  }
  rt::Result<void> take(const app::FrameRecord& r) override {
    const rt::TimeNs now = rt::monotonic_now_ns();
    if (now >= t_next_look_ns_) {
      threads_.look(now);
      t_next_look_ns_ = now + kLookPeriodNs;
      figures_->resident_mb = line_of_status_mb("VmRSS:");
      figures_->locked_mb = line_of_status_mb("VmLck:");
    }
    drain();
    watchers_->frame(r);
    if (t_first_ns_ == 0) t_first_ns_ = r.t_capture_ns;
    ++figures_->due;
    if (r.fate == app::FrameFate::kBadPicture) ++figures_->bad;
    if (r.fate == app::FrameFate::kDroppedSlots || r.fate == app::FrameFate::kDroppedLate) ++figures_->dropped;
    if (r.fate != app::FrameFate::kProcessed) return {};
    ++figures_->processed;
    const rt::TimeNs delivered_ns = r.t_delivered_ns - r.t_capture_ns;
    const rt::TimeNs due_ns = delivery_ns_ < 0 ? delivered_ns : delivery_ns_;
    figures_->seconds = rt::to_seconds(r.t_done_ns - t_first_ns_ - due_ns);
    const double age_ms = rt::to_ms(r.t_done_ns - r.t_capture_ns);
    const double own_ms = age_ms - rt::to_ms(due_ns);
    delivery_.push_back(rt::to_ms(delivered_ns));
    if (own_ms > deadline_ms_) ++figures_->missed_deadlines;
    if (!r.tracked) return {};
    if (figures_->first_pose_frames < 0) {
      figures_->first_pose_frames = static_cast<std::int64_t>(figures_->due) - 1;
      figures_->first_pose_ms = rt::to_ms(r.t_capture_ns - t_first_ns_);
    }
    ++figures_->tracked;
    figures_->t_s.push_back(static_cast<float>(rt::to_seconds(r.t_capture_ns - t_first_ns_)));
    figures_->age_ms.push_back(static_cast<float>(age_ms));
    figures_->own_ms.push_back(static_cast<float>(own_ms));
    age_.push_back(age_ms);
    own_.push_back(own_ms);
    cpu_.push_back(rt::to_ms(r.thread_cpu_ns));
    for (std::size_t i = 0; i < app::kStages; ++i) stages_[i].push_back(rt::to_ms(r.stage_ns[i]));
    return {};
  }

  /// Link thread's news, also after the last frame.
  void drain() {
    for (link::PoseDeparture d; departures_->try_pop(&d);) {
      bus_.push_back(rt::to_ms(d.t_sent_ns - d.t_capture_ns));
    }
  }

  void finish() {
    drain();
    figures_->delivery = distribution_of(std::move(delivery_));
    // A departure does not tell when its picture was delivered: a live camera's median stands for it.
    const double delivery_ms = delivery_ns_ < 0 ? figures_->delivery.p50 : rt::to_ms(delivery_ns_);
    for (const double age_ms : bus_) own_bus_.push_back(age_ms - delivery_ms);
    figures_->age_at_pose = distribution_of(std::move(age_));
    figures_->own_at_pose = distribution_of(std::move(own_));
    figures_->age_at_bus = distribution_of(std::move(bus_));
    figures_->own_at_bus = distribution_of(std::move(own_bus_));
    figures_->tracker_cpu = distribution_of(std::move(cpu_));
    for (std::size_t i = 0; i < app::kStages; ++i) figures_->stages[i] = distribution_of(std::move(stages_[i]));
    if (figures_->seconds > 0) {
      figures_->poses_hz = static_cast<double>(figures_->tracked) / figures_->seconds;
    }
    figures_->threads = threads_.uses();
    figures_->peak_mb = app::peak_memory_mb();
  }

 private:
  FlightFigures* figures_;
  const rt::TimeNs delivery_ns_;
  const double deadline_ms_;
  link::DepartureRing* departures_;
  Watchers* const watchers_;
  ThreadWatch threads_;
  rt::TimeNs t_next_look_ns_ = 0, t_first_ns_ = 0;
  std::vector<double> delivery_, age_, own_, bus_, own_bus_, cpu_;
  std::array<std::vector<double>, app::kStages> stages_;
};

}  // namespace

Distribution distribution_of(std::vector<double> values) {
  Distribution d;
  if (values.empty()) return d;
  std::sort(values.begin(), values.end());
  d.samples = values.size();
  const auto at = [&](double percent) { return app::percentile_of_sorted(values, percent); };
  d.p50 = at(50);
  d.p95 = at(95);
  d.p99 = at(99);
  d.p999 = at(99.9);
  d.max = values.back();
  for (const double v : values) d.mean += v / static_cast<double>(values.size());
  return d;
}

rt::Result<Pictures> load_pictures(const Options& o, const std::atomic<bool>& stop) {
  Pictures out;
  out.name = o.input;
  std::unique_ptr<hal::Camera> source;
  std::unique_ptr<sim::Flight> flight;
  if (std::filesystem::is_directory(o.input)) {
    hal::ReplayOptions replay;
    auto opened = hal::ReplayCamera::open(o.input, replay);
    if (!opened) return opened.error();
    out.calibration = opened.value()->calibration();
    source = std::move(opened).value();
  } else {
    const auto scenario = sim::find_scenario(o.input, app::scenario_folder({}));
    if (!scenario) {
      return rt::Error{o.input + ": neither the folder of a sequence nor a scenario: " + scenario.error().message};
    }
    flight = std::make_unique<sim::Flight>(scenario.value(), o.seed);
    out.calibration = app::calibration_of(*flight);
    source = flight->camera(0);
    out.name += ", seed " + std::to_string(o.seed);
  }
  out.fps = o.fps > 0 ? o.fps : out.calibration.fps > 0 ? out.calibration.fps : kDefaultFps;
  // The readout is a share of the frame interval: another rate must not change the pictures' own.
  if (out.calibration.fps > 0) out.calibration.readout_frames *= out.fps / out.calibration.fps;
  out.calibration.fps = out.fps;
  // More than are flown would be drawn for nothing.
  const std::int64_t wanted = std::min(o.pictures, flown_pictures(o, out.fps));
  const auto room = app::room_for_pictures(wanted, source->width(), source->height());
  if (!room) return rt::Error{"--pictures: " + room.error().message + "; hold fewer"};
  auto camera = app::LoopedPictures::record(source.get(), static_cast<int>(wanted), {}, stop);
  if (!camera) return camera.error();
  out.camera = std::move(camera).value();
  // The pictures are kept grey: no slot needs room for colour.
  out.calibration.channels = 1;
  // What reading or drawing needed goes back, so that the memory told is the flight's.
  source.reset();
  flight.reset();
  malloc_trim(0);
  return out;
}

rt::Result<Pictures> live_pictures(const app::Config& config) {
  if (!config.camera.live()) {
    return rt::Error{"camera.source: \"v4l2\" or \"libcamera\" is what --camera flies; for the others there is INPUT"};
  }
  const auto opened = app::open_camera(config.camera, [](const std::string&) {});
  if (!opened) return opened.error();
  Pictures out;
  out.name = "camera " + config.camera.device;
  out.calibration = opened.value().calibration;
  out.fps = out.calibration.fps > 0 ? out.calibration.fps : kDefaultFps;
  return out;
}

rt::Result<FlightFigures> fly(const Pictures& pictures, const Options& o, app::Config config, bool detector,
                              const std::atomic<bool>& stop) {
  FlightFigures figures;
  figures.detector = config.detector.enabled = detector;
  figures.deadline_ms = 1000 / pictures.fps;
  const bool live = pictures.camera == nullptr;
  if (!live) {
    figures.pictures_mb = 1e-6 * pictures.camera->pictures() * pictures.camera->width() * pictures.camera->height();
  }
  if (!o.can.empty()) config.can.bus = o.can;
  std::unique_ptr<app::LivePicture> picture;
  app::AssemblyPlan plan;
  if (o.watched) {
    picture = app::live_picture(config, pictures.calibration.width, pictures.calibration.height);
    plan.view = picture.get();
    plan.onlooker = !app::events_folder(config).empty();
  }
  auto assembled = app::assemble(config, pictures.calibration, plan);
  if (!assembled) return assembled.error();
  const app::Assembly& parts = assembled.value();

  app::LoopedPictures::Options looped;
  looped.interval_ns = static_cast<rt::TimeNs>(1e9 / pictures.fps);
  looped.total = flown_pictures(o, pictures.fps);
  looped.delivery_ns = static_cast<rt::TimeNs>(o.delays.delivery_ms() * 1e6);
  HeapWatch camera_heap, tracker_heap;
  std::unique_ptr<hal::Camera> source;
  if (live) {
    auto opened = app::open_camera(config.camera,
                                   [](const std::string& words) { fmt::print(stderr, "godwit-latency: {}\n", words); });
    if (!opened) return opened.error();
    source = std::move(opened.value().camera);
  } else {
    source = pictures.camera->again(looped);
  }
  WatchedCamera camera(std::move(source), live ? static_cast<rt::TimeNs>(o.seconds * 1e9) : 0, &camera_heap);

  app::PipelineOptions pipeline;
  pipeline.newest_frame = true;
  const hal::MachineMonitor machine;
  pipeline.machine = &machine;
  parts.plan_detector(&pipeline);
  WatchedDetector watched(pipeline.detector, pipeline.scheduler.input_px);
  if (pipeline.detector != nullptr) pipeline.detector = &watched;
  app::plan_pipeline(config, pictures.fps, &pipeline);
  link::DepartureRing departures;
  auto link = app::start_link(
      config, pictures.calibration.T_body_cam, [](app::LinkLogLevel, const std::string&) {}, stop, &departures);
  if (!link) return link.error();
  app::LinkRunner* const autopilot = link.value().get();
  WatchedTap tap(autopilot, &tracker_heap);
  pipeline.tap = &tap;
  Watchers watchers;
  if (o.watched) {
    const auto started = watchers.start(config, pictures.calibration, parts.pool.get(), picture.get(), &pipeline);
    if (!started) return started.error();
  }
  figures.refused = app::arm_memory(config);
  Collector collector(&figures, live ? -1 : looped.delivery_ns, figures.deadline_ms, &departures, &watchers);
  const auto run = app::run_pipeline(&camera, parts.stage.get(), parts.pool.get(), pipeline, &collector, stop);
  if (!run) return run.error();
  if (stop.load(std::memory_order_relaxed)) return rt::Error{"interrupted"};
  std::vector<app::ThreadReport> reports = run.value().threads;
  if (autopilot != nullptr) {
    autopilot->finish();
    reports.push_back(autopilot->thread_report());
  }
  collector.finish();
  const app::SchedulerCounters& s = run.value().scheduler;
  const auto detections = watched.cpu_ms();
  for (std::size_t i = 0; i < detections.size(); ++i) figures.detection_cpu[i] = distribution_of(detections[i]);
  figures.detections = s.detections;
  figures.detections_failed = s.detections_failed;
  figures.detections_late = s.detections_late;
  figures.rung = app::rung_name(run.value().rung);
  for (ThreadUse& use : figures.threads) {
    for (const app::ThreadReport& report : reports) {
      const std::string name = report.name;
      if (use.name != name && use.name != "gw-" + name) continue;
      use.minor_faults = static_cast<std::int64_t>(report.faults.minor);
      use.major_faults = static_cast<std::int64_t>(report.faults.major);
    }
    if (use.name == "gw-camera") use.allocations = camera_heap.count();
    if (use.name == "gw-tracker") use.allocations = tracker_heap.count();
  }
  return figures;
}

}  // namespace godwit::bench
