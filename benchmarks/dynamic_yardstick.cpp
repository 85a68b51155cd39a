// godwit-dynamic-yardstick SEQUENCE --model FILE: what leaving movers out costs the tracker's thread, in units that do
// not depend on the machine (benchmarks/yardstick.h).
//
// The real network looks at every --period-th frame; its boxes arrive --late frames later, as from a thread of its own,
// and its own time is not counted. Timed, for each frame:
// - masks and carrying: DynamicMasks::mask_for, boxes followed by the picture inside them and masked at every level;
// - late masks and parked vehicles: MaskExchange, keyframes purged by detections that came after them, and what a
//   tracked frame says of the boxes in it;
// - gate: MotionGate::run and the second pose that it asks for, on the measurements of each frame that has a pose.
//   Counted for every such frame as if the gate had rejected something in it, so it is an upper bound;
// and for every --look-th frame, because it is asked only when the pose is lost between movers: LandmarkFinder::find.
#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <CLI/Validators.hpp>
#include <algorithm>
#include <array>
#include <deque>
#include <fmt/format.h>
#include <memory>
#include <vector>

#include "benchmarks/last_catch.h"
#include "benchmarks/yardstick.h"
#include "firmware_app/config/config.h"
#include "firmware_app/dynamic/dynamic_masks.h"
#include "firmware_app/pipeline/feeder.h"
#include "firmware_app/pipeline/mask_exchange.h"
#include "firmware_app/pipeline/odometry_stage.h"
#include "hal/camera/replay/replay_camera.h"
#include "vo_core/features/match_noise.h"
#include "vo_core/image/pyramid.h"
#include "vo_core/map/mapper.h"
#include "vo_core/tracking/landmark_finder.h"
#include "vo_core/tracking/tracker.h"

namespace {

using namespace godwit;

struct Options {
  std::string sequence, model;
  hal::ReplayOptions replay;
  int period = 5, late = 3, look = 5;
};

template <typename Work>
double time_ms(const Work& work) {
  const rt::TimeNs begin = rt::thread_cpu_now_ns();
  work();
  return rt::to_ms(rt::thread_cpu_now_ns() - begin);
}

/// The gate and the pose after it, on the measurements that the tracker has just used.
class GateReplay {
 public:
  explicit GateReplay(const vo::CameraModel& camera)
      : camera_(camera), gate_(camera.width(), camera.height(), {.on = true}) {}

  double time(const vo::Tracker& tracker, const vo::FrameResult& result) {
    features_.clear();
    measurements_.clear();
    for (const vo::FrameFeature& f : tracker.features()) {
      const vo::MapPoint* point = tracker.map().find(f.point);
      if (point == nullptr) continue;
      vo::PoseMeasurement m;
      m.px = f.px_global.cast<double>();
      m.gradient = f.gradient.cast<double>();
      m.p_world = point->p_world;
      m.sigma_px = vo::match_sigma_px(f.level);
      m.type = f.type;
      // One part of the picture moves: there is something to sort out.
      m.inlier = (f.px - tracker.features()[0].px).norm() > 60.F;
      features_.push_back(f);
      measurements_.push_back(m);
    }
    vo::SE3 T_cam_world = result.T_world_cam.inverse();
    return time_ms([&] {
      const int left = gate_.run(features_, measurements_);
      vo::optimize_pose(camera_, {}, std::span(measurements_.data(), static_cast<std::size_t>(left)), &T_cam_world);
    });
  }

 private:
  const vo::CameraModel& camera_;
  vo::MotionGate gate_;
  std::vector<vo::FrameFeature> features_;
  std::vector<vo::PoseMeasurement> measurements_;
};

/// The landmark finder asked beside the tracker, which asks it only when it is lost.
class FinderReplay {
 public:
  explicit FinderReplay(const vo::CameraModel& camera) : finder_(camera, {}) {}

  void note_map(std::uint32_t map_id) {
    if (map_id != 0 && map_id != map_id_) finder_.forget();
    if (map_id != 0) map_id_ = map_id;
  }
  double learn(const vo::Map& map) {
    return time_ms([&] { finder_.learn(map, vo::LandmarkFinderOptions{}.described_a_tracked_frame); });
  }
  double find(const vo::Map& map, const rt::PyramidView& pyramid, const rt::MaskPyramidView& mask) {
    return time_ms([&] { found_ += finder_.find(map, pyramid, mask, attempt_++).found; });
  }
  int found() const { return found_; }
  int attempts() const { return attempt_; }

 private:
  vo::LandmarkFinder finder_;
  std::uint32_t map_id_ = 0;
  int attempt_ = 0, found_ = 0;
};

int fail(const std::string& why) {
  fmt::print(stderr, "godwit-dynamic-yardstick: {}\n", why);
  return 2;
}

int run(const Options& options) {
  auto source = hal::ReplayCamera::open(options.sequence, options.replay);
  if (!source) return fail(source.error().message);
  const hal::CameraCalibration& calibration = source.value()->calibration();
  auto model = app::make_camera_model(calibration);
  if (!model) return fail(model.error().message);
  const vo::CameraModel& camera = model.value();
  rt::FramePool::Layout layout;
  layout.width = source.value()->width();
  layout.height = source.value()->height();
  layout.pyramid_bytes = app::odometry_pyramid_bytes(layout.width, layout.height);
  layout.slots =
      std::min(app::odometry_frame_slots() + std::max(options.late + 1, app::kDetectorSlots), rt::kMaxFrameSlots);
  layout.readers = app::kFrameReadersWithDetector;
  layout.colour = calibration.channels == 3;
  auto made = rt::FramePool::create(layout);
  if (!made) return fail(made.error().message);
  rt::FramePool* const pool = made.value().get();
  app::DynamicMasksOptions dynamic;
  dynamic.model = options.model;
  auto opened = app::DynamicMasks::open(dynamic, camera, pool);
  if (!opened) return fail(opened.error().message);
  app::DynamicMasks* const masks = opened.value().get();

  vo::MapperOptions mapper_options;
  mapper_options.shutter.readout_s = calibration.readout_s();
  vo::TrackerOptions tracker_options;
  tracker_options.delta_delay_frames = app::Config{}.pipeline.mapper_delay_frames;
  tracker_options.gate.on = true;
  tracker_options.initializer.readout = calibration.readout_frames;
  tracker_options.shutter.readout_s = calibration.readout_s();
  const auto channel = std::make_unique<vo::MapChannel>();
  vo::Tracker tracker(camera, tracker_options, channel.get());
  vo::Mapper mapper(camera, mapper_options, channel.get());
  app::MaskExchange exchange(masks, &tracker);
  GateReplay gate(camera);
  FinderReplay finder(camera);

  app::Feeder feeder(source.value().get(), pool, false, nullptr);
  std::array<rt::FrameReturn, 3> give = {pool->reader(app::kTrackerReader), pool->reader(app::kMapperReader),
                                         pool->reader(app::kDetectorReader)};
  cv::setNumThreads(1);
  std::vector<double> yardstick, masking, exchanging, gating, guards, learning, finding, tracking, lost;
  std::deque<std::pair<int, rt::FrameHandle>> looked_at;  // and when its boxes arrive
  cv::Mat earlier, later;
  int frames = 0, tracked = 0, crowded = 0;
  double covered = 0.0;
  while (true) {
    rt::FrameHandle handle;
    app::FrameRecord record;
    const auto outcome = feeder.read(pool->acquire(), rt::kNsPerSecond, &handle, &record);
    if (outcome == app::Feeder::Outcome::kEnd) break;
    if (outcome != app::Feeder::Outcome::kFrame) continue;
    const int frame = frames++;
    const rt::MutableImageView grey = pool->grey(handle.slot);
    cv::Mat(grey.height, grey.width, CV_8UC1, grey.data, static_cast<std::size_t>(grey.stride)).copyTo(later);
    while (!looked_at.empty() && looked_at.front().first <= frame) {
      masks->detect({.frame = looked_at.front().second});
      give[app::kDetectorReader].give_back(looked_at.front().second.slot);
      looked_at.pop_front();
    }
    if (!earlier.empty()) {
      const double ms = bench::time_yardstick(earlier, later);
      if (ms >= 0) yardstick.push_back(ms);
    }

    vo::FrameInput input;
    input.grey = grey;
    input.pyramid_storage = pool->pyramid_storage(handle.slot);
    input.pyramid_bytes = pool->pyramid_bytes();
    input.slot = handle.slot;
    input.sequence = handle.meta.sequence;
    input.t_capture_ns = handle.meta.t_capture_ns;
    masking.push_back(time_ms([&] { input.mask = masks->mask_for(handle.meta, input.grey); }));
    exchanging.push_back(time_ms([&] { exchange.purge_movers(input.t_capture_ns); }));
    const double share = vo::covered_share(input.mask);
    covered += share;
    vo::FrameResult result;
    const double tracking_ms = time_ms([&] { result = tracker.track(input); });
    exchanging.back() += time_ms([&] { exchange.frame_done(input.t_capture_ns, result); });
    guards.push_back(masking.back() + exchanging.back());
    tracked += result.tracked;
    finder.note_map(result.map_id);
    if (result.map_id != 0) (result.tracked ? tracking : lost).push_back(guards.back() + tracking_ms);
    if (result.tracked) {
      gating.push_back(gate.time(tracker, result));
      guards.back() += gating.back();
    }
    if (share > tracker_options.crowded && result.map_id != 0) {
      ++crowded;
      if (result.tracked) learning.push_back(finder.learn(tracker.map()));
      if (crowded % options.look == 0) {
        // Where the tracker has built it already.
        const rt::PyramidView pyramid =
            vo::build_pyramid(input.grey, rt::kPyramidLevels, input.pyramid_storage, input.pyramid_bytes);
        finding.push_back(finder.find(tracker.map(), pyramid, input.mask));
      }
    }
    while (mapper.step()) {
    }
    vo::SlotRelease release;
    while (tracker.take_release(&release)) give[app::kTrackerReader].give_back(release.slot, release.count);
    while (mapper.take_release(&release)) give[app::kMapperReader].give_back(release.slot, release.count);
    if (frame % options.period == 0)
      looked_at.emplace_back(frame + options.late, handle);
    else
      give[app::kDetectorReader].give_back(handle.slot);
    cv::swap(earlier, later);
  }
  if (yardstick.empty() || masking.empty()) return fail(options.sequence + ": nothing to compare");
  const double y = app::statistics_of(yardstick).median;
  fmt::print(
      "{} frames, {} tracked, {:.0f} % of the picture masked on average, more than {:.0f} % in {} frames of a "
      "map; thread CPU time\n",
      frames, tracked, 100.0 * covered / frames, 100.0 * tracker_options.crowded, crowded);
  bench::print_heading();
  bench::print_row("yardstick (Y = median)", yardstick, y);
  bench::print_row("masks and carrying", masking, y);
  bench::print_row("late masks, parked vehicles", exchanging, y);
  bench::print_row("gate, as if always needed", gating, y);
  bench::print_row("all of these", guards, y);
  bench::print_row("looks of points, in a crowd", learning, y);
  bench::print_row("masks and tracking, tracked", tracking, y);
  bench::print_row("the same, pose lost", lost, y);
  bench::print_row("one look for landmarks", finding, y);
  fmt::print("The landmark finder was asked {} times and found a pose {} times.\n", finder.attempts(), finder.found());
  return 0;
}

int measure(int argc, char** argv) {
  CLI::App cli("Times what leaving movers out costs the tracker's thread against a workload of known size.",
               "godwit-dynamic-yardstick");
  Options options;
  options.model = GODWIT_MODEL_DIR "/cbam_yolov5n_416.onnx";
  cli.add_option("SEQUENCE", options.sequence, "Folder in TUM or EuRoC layout")->required();
  cli.add_option("--model", options.model, "Network (default: detector/models/cbam_yolov5n_416.onnx)");
  cli.add_option("--period", options.period, "The network looks at every N-th frame")->check(CLI::PositiveNumber);
  cli.add_option("--late", options.late, "Its boxes arrive N frames later")->check(CLI::Range(0, 30));
  cli.add_option("--look", options.look, "The landmark finder is asked in every N-th crowded frame")
      ->check(CLI::PositiveNumber);
  cli.add_option("--start", options.replay.start, "Leave out the first N pictures")->check(CLI::NonNegativeNumber);
  cli.add_option("--frames", options.replay.frames, "Stop after N pictures (default: all)")->check(CLI::PositiveNumber);
  CLI11_PARSE(cli, argc, argv);
  return run(options);
}

}  // namespace

int main(int argc, char** argv) {
  return bench::last_catch("godwit-dynamic-yardstick", measure, argc, argv);
}
