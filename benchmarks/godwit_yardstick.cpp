// godwit-yardstick SEQUENCE: the tracker's cost in units that do not depend on the machine.
//
// Decoding, corner choice and copies lie outside both times. What Y is: benchmarks/yardstick.h.
#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <CLI/Validators.hpp>
#include <fmt/format.h>
#include <vector>

#include "benchmarks/last_catch.h"
#include "benchmarks/yardstick.h"
#include "firmware_app/config/config.h"
#include "firmware_app/pipeline/feeder.h"
#include "firmware_app/pipeline/odometry_stage.h"
#include "firmware_app/pipeline/stage.h"
#include "hal/camera/replay/replay_camera.h"

namespace {

using namespace godwit;

int run(const std::string& sequence, const hal::ReplayOptions& replay) {
  auto camera = hal::ReplayCamera::open(sequence, replay);
  if (!camera) {
    fmt::print(stderr, "godwit-yardstick: {}\n", camera.error().message);
    return 2;
  }
  auto model = app::make_camera_model(camera.value()->calibration());
  if (!model) {
    fmt::print(stderr, "godwit-yardstick: {}\n", model.error().message);
    return 2;
  }
  rt::FramePool::Layout layout;
  layout.width = camera.value()->width();
  layout.height = camera.value()->height();
  layout.pyramid_bytes = app::odometry_pyramid_bytes(layout.width, layout.height);
  layout.slots = app::odometry_frame_slots();
  layout.readers = app::kFrameReaders;
  auto pool = rt::FramePool::create(layout);
  if (!pool) {
    fmt::print(stderr, "godwit-yardstick: {}\n", pool.error().message);
    return 2;
  }
  app::OdometryOptions odometry = app::odometry_options(camera.value()->calibration());
  odometry.mapper_delay_frames = app::Config{}.pipeline.mapper_delay_frames;
  const auto stage = app::make_odometry_stage(model.value(), odometry, pool.value().get());
  app::Feeder feeder(camera.value().get(), pool.value().get(), false, nullptr);

  cv::setNumThreads(1);
  std::vector<double> yardstick, tracking, mapping, both;
  cv::Mat earlier, later;
  int frames = 0, tracked = 0;
  while (true) {
    rt::FrameHandle handle;
    app::FrameRecord record;
    const auto outcome = feeder.read(pool.value()->acquire(), rt::kNsPerSecond, &handle, &record);
    if (outcome == app::Feeder::Outcome::kEnd) break;
    if (outcome != app::Feeder::Outcome::kFrame) continue;
    ++frames;
    // A copy: the slot goes to the tracker, and the yardstick needs this picture again with the next.
    const rt::MutableImageView grey = pool.value()->grey(handle.slot);
    cv::Mat(grey.height, grey.width, CV_8UC1, grey.data, static_cast<std::size_t>(grey.stride)).copyTo(later);
    if (!earlier.empty()) {
      const double ms = bench::time_yardstick(earlier, later);
      if (ms >= 0) yardstick.push_back(ms);
    }
    app::track_frame(stage.get(), handle, &record);
    const rt::TimeNs before = rt::thread_cpu_now_ns();
    while (stage->map_step()) {
    }
    const double mapping_ms = rt::to_ms(rt::thread_cpu_now_ns() - before);
    if (record.tracked) {
      ++tracked;
      tracking.push_back(rt::to_ms(record.thread_cpu_ns));
      mapping.push_back(mapping_ms);
      both.push_back(tracking.back() + mapping_ms);
    }
    cv::swap(earlier, later);
  }
  if (yardstick.empty() || tracking.empty()) {
    fmt::print(stderr, "godwit-yardstick: {}: {} frames, {} tracked: nothing to compare\n", sequence, frames, tracked);
    return 1;
  }
  const double y = app::statistics_of(yardstick).median;
  fmt::print("{} frames, {} tracked ({:.2f} %); thread CPU time, tracked frames only\n", frames, tracked,
             100.0 * tracked / frames);
  bench::print_heading();
  bench::print_row("yardstick (Y = median)", yardstick, y);
  bench::print_row("tracking", tracking, y);
  bench::print_row("mapping", mapping, y);
  bench::print_row("tracking and mapping", both, y);
  return 0;
}

int measure(int argc, char** argv) {
  CLI::App cli("Times the tracker against a workload of known size, frame by frame in one run.", "godwit-yardstick");
  std::string sequence;
  hal::ReplayOptions replay;
  cli.add_option("SEQUENCE", sequence, "Folder in TUM or EuRoC layout")->required();
  cli.add_option("--start", replay.start, "Leave out the first N pictures")->check(CLI::NonNegativeNumber);
  cli.add_option("--frames", replay.frames, "Stop after N pictures (default: all)")->check(CLI::PositiveNumber);
  CLI11_PARSE(cli, argc, argv);
  return run(sequence, replay);
}

}  // namespace

int main(int argc, char** argv) {
  return bench::last_catch("godwit-yardstick", measure, argc, argv);
}
