#include "firmware_app/commands/replay_command.h"

#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <CLI/Validators.hpp>
#include <fmt/format.h>

#include "firmware_app/commands/exit_code.h"
#include "firmware_app/config.h"
#include "firmware_app/output/progress_bar.h"
#include "firmware_app/output/run_writer.h"
#include "firmware_app/pipeline/odometry_stage.h"
#include "firmware_app/pipeline/pipeline.h"
#include "hal/camera/replay/replay_camera.h"

namespace godwit::app {
namespace {

int refuse(const std::string& message) {
  fmt::print(stderr, "godwit: {}\n", message);
  return kExitRefused;
}

int failed(const std::string& message) {
  fmt::print(stderr, "godwit: {}\n", message);
  return kExitFailed;
}

/// Passes the frames on and shows how far the run is.
class ShowingSink final : public FrameSink {
 public:
  ShowingSink(FrameSink* next, ProgressBar* bar) : next_(next), bar_(bar) {}
  rt::Result<void> take(const FrameRecord& record) override {
    bar_->show(++done_, record.state);
    return next_->take(record);
  }

 private:
  FrameSink* next_;
  ProgressBar* bar_;
  std::int64_t done_ = 0;
};

/// What this version cannot do is refused, not ignored: a result without it would pass for one with it.
std::string missing_part(const ReplayArguments& a) {
  if (a.detector == "on") return "--detector on: this version has no detector yet; leave it off";
  if (a.gate == "on") return "--gate on: this version has no gate against moving things yet; leave it off";
  if (a.imu == "on") return "--imu on: this version does not use an IMU yet; leave it off";
  if (!a.model.empty()) return "--model: is for the detector, which this version does not have yet";
  return {};
}

void tell(const RunWriter& writer, const std::string& folder) {
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
  } else {
    fmt::print("no pose was found\n");
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

}  // namespace

void add_replay_command(CLI::App* app, ReplayArguments* a) {
  CLI::App* replay = app->add_subcommand("replay", "Fly a recorded sequence: a pose for every frame out");
  replay
      ->add_option(
          "SEQUENCE", a->sequence,
          "Folder in TUM layout (rgb.txt, pictures, camera.yaml) or EuRoC/ASL layout (mav0/cam0 with data.csv, "
          "data/ and sensor.yaml; mav0 or cam0 itself will do)")
      ->required();
  replay->add_option("--config", a->config_file, "Configuration (TOML); config/godwit.toml lists every key")
      ->type_name("FILE");
  replay->add_option("--out", a->out, "Folder for the results, made if it is not there")
      ->type_name("DIR")
      ->capture_default_str();
  replay
      ->add_option(
          "--pace", a->pace,
          "max: as fast as it goes, nothing is dropped; real: pictures come at their capture times, and a frame "
          "that finds the tracker busy gives way to the next")
      ->check(CLI::IsMember({"max", "real"}))
      ->capture_default_str();
  replay->add_flag("--sequential", a->sequential,
                   "All stages in one thread in a fixed order: two runs are equal to the bit");
  replay->add_option("--start", a->start, "Leave out the first N pictures")
      ->type_name("N")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  replay->add_option("--frames", a->frames, "Stop after N pictures (default: all)")
      ->type_name("N")
      ->check(CLI::PositiveNumber);
  const auto on_off = [&](const char* name, std::string* value, const char* what) {
    replay->add_option(name, *value, what)->check(CLI::IsMember({"on", "off"}))->capture_default_str();
  };
  on_off("--detector", &a->detector, "Find what may move by a network and leave it out");
  on_off("--gate", &a->gate, "Find what moves by geometry and leave it out");
  on_off("--imu", &a->imu, "Use the sequence's IMU");
  replay->add_option("--model", a->model, "The detector's network")->type_name("FILE");
  replay->footer(
      "Writes trajectory.tum, frames.csv, pose.csv and summary.json; summary.json comes last, so a folder that\n"
      "has one is whole.\n"
      "Example: godwit replay ../shared/data/tum_fr1_xyz --sequential --out out/fr1");
}

int run_replay(const ReplayArguments& a, const std::atomic<bool>& stop) {
  const std::string missing = missing_part(a);
  if (!missing.empty()) return refuse(missing);
  if (a.sequential && a.pace == "real") return refuse("--sequential has no pace: leave --pace real out");

  ConfigReport config;
  if (!a.config_file.empty()) config = load_config(a.config_file);
  if (!config.ok()) {
    for (const std::string& mistake : config.mistakes) refuse(mistake);
    return kExitRefused;
  }

  hal::ReplayOptions replay;
  replay.pace = a.pace == "real" ? hal::ReplayOptions::Pace::kReal : hal::ReplayOptions::Pace::kMax;
  replay.start = a.start;
  replay.frames = a.frames;
  auto camera = hal::ReplayCamera::open(a.sequence, replay);
  if (!camera) return refuse(camera.error().message);
  const hal::CameraCalibration& calibration = camera.value()->calibration();
  auto model = make_camera_model(calibration);
  if (!model) return refuse(camera.value()->layout().calibration_file + ": " + model.error().message);

  rt::FramePool::Layout layout;
  layout.width = calibration.width;
  layout.height = calibration.height;
  layout.pyramid_bytes = odometry_pyramid_bytes(layout.width, layout.height);
  layout.slots = config.config.pipeline.frame_slots;
  if (layout.slots == 0) layout.slots = odometry_frame_slots();
  layout.readers = kFrameReaders;
  auto pool = rt::FramePool::create(layout);
  if (!pool) return refuse(pool.error().message);

  OdometryOptions odometry;
  odometry.readout_frames = calibration.readout_frames;
  if (a.sequential) odometry.mapper_delay_frames = config.config.pipeline.mapper_delay_frames;
  const auto stage = make_odometry_stage(model.value(), odometry, pool.value().get());

  PipelineOptions pipeline;
  pipeline.sequential = a.sequential;
  pipeline.newest_frame = a.pace == "real";
  RunWriter writer;
  auto opened = writer.open(a.out, pipeline.newest_frame);
  if (!opened) return failed(opened.error().message);
  rt::Result<PipelineCounters> run = rt::Error{""};
  {
    ProgressBar bar(camera.value()->total());
    ShowingSink sink(&writer, &bar);
    run = run_pipeline(camera.value().get(), stage.get(), pool.value().get(), pipeline, &sink, stop);
  }
  if (!run) return failed(run.error().message);
  if (stop.load(std::memory_order_relaxed)) {
    fmt::print(stderr, "godwit: interrupted; nothing was written\n");
    return kExitInterrupted;
  }
  auto finished = writer.finish({GODWIT_VERSION, a.sequence, a.sequential ? "sequential" : "threads", a.pace, a.start});
  if (!finished) return failed(finished.error().message);
  tell(writer, a.out);
  return kExitDone;
}

}  // namespace godwit::app
