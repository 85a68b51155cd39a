#include "firmware_app/commands/doctor_tilt.h"

#include <array>
#include <poll.h>
#include <unistd.h>

#include "firmware_app/autopilot/pose_sampler.h"
#include "firmware_app/commands/doctor_autopilot.h"
#include "firmware_app/config/link_settings.h"
#include "firmware_app/link/tilt_test.h"
#include "firmware_app/pipeline/odometry_stage.h"
#include "firmware_app/pipeline/pipeline.h"
#include "hal/rt/process_end.h"
#include "hal/rt/thread.h"

namespace godwit::app {
namespace {

constexpr rt::TimeNs kFreshNs = rt::kNsPerSecond;

/// The newest attitude of the odometry, handed from its thread to ours.
class AttitudeTap final : public FrameTap {
 public:
  explicit AttitudeTap(const Eigen::Matrix3d& R_body_cam) : sampler_(world_of_level_start(R_body_cam)) {}
  void frame_done(const FrameRecord& record) override { samples_.write(sampler_.sample(record)); }
  bool newest(link::PoseSample* sample) {
    if (samples_.read(&kept_)) any_ = true;
    *sample = kept_;
    return any_;
  }

 private:
  PoseSampler sampler_;
  rt::TripleBuffer<link::PoseSample> samples_;
  link::PoseSample kept_;
  bool any_ = false;
};

class NoSink final : public FrameSink {
 public:
  rt::Result<void> take(const FrameRecord&) override { return {}; }
};

/// True when a line came; *end: standard input is at its end.
bool line_came(bool* end) {
  pollfd event{STDIN_FILENO, POLLIN, 0};
  if (poll(&event, 1, 0) <= 0) return false;
  std::array<char, 256> text{};
  const ssize_t n = read(STDIN_FILENO, text.data(), text.size());
  *end = n <= 0;
  return n > 0;
}

/// Asks for each step and takes both attitudes when Enter is pressed. Error: it could not be finished.
rt::Result<link::TiltTest> guide(link::LinkService* service, AttitudeTap* ours, const link::OdometryConfig& mounting,
                                 const std::atomic<bool>& stop) {
  link::TiltTest test;
  Eigen::Vector4d autopilot = Eigen::Vector4d::Zero();
  rt::TimeNs t_autopilot_ns = 0;
  bool ask = true;
  while (test.step() != link::TiltTest::Step::kDone) {
    if (stop.load(std::memory_order_relaxed)) return rt::Error{"interrupted"};
    if (ask) {
      fmt::print("      {} Then press Enter.\n", link::TiltTest::instruction(test.step()));
      std::fflush(stdout);
      ask = false;
    }
    step_link(service);
    link::AutopilotInput input;
    while (service->take_input(&input)) {
      if (input.kind != link::InputKind::kAttitude) continue;
      autopilot = Eigen::Vector4d(input.value.data());
      t_autopilot_ns = input.t_arrival_ns;
    }
    bool end = false;
    if (!line_came(&end)) {
      if (end) return rt::Error{"standard input ended before the test did"};
      continue;
    }
    ask = true;
    const rt::TimeNs now = rt::monotonic_now_ns();
    link::PoseSample sample;
    if (t_autopilot_ns == 0 || now - t_autopilot_ns > kFreshNs) {
      fmt::print("      The autopilot does not send its attitude (ATTITUDE_QUATERNION).\n");
      continue;
    }
    const bool tracked =
        ours->newest(&sample) && sample.state == link::PoseState::kTracking && now - sample.t_capture_ns < kFreshNs;
    if (!tracked) {
      fmt::print("      The camera has no pose: let it see something with texture and move it a little sideways.\n");
      continue;
    }
    const auto held = test.hold(autopilot, link::body_pose(sample, mounting).q);
    if (!held) fmt::print("      {}\n", held.error().message);
  }
  return test;
}

}  // namespace

void tilt_test(const Config& config, DoctorCamera* camera, link::LinkService* service, DoctorReport* report,
               const std::atomic<bool>& stop) {
  auto model = make_camera_model(camera->calibration);
  if (!model) return report->wrong("tilt test: " + model.error().message);
  rt::FramePool::Layout layout;
  layout.width = camera->calibration.width;
  layout.height = camera->calibration.height;
  layout.pyramid_bytes = odometry_pyramid_bytes(layout.width, layout.height);
  layout.slots = odometry_frame_slots();
  layout.readers = kFrameReaders;
  auto pool = rt::FramePool::create(layout);
  if (!pool) return report->wrong("tilt test: " + pool.error().message);
  const auto stage = make_odometry_stage(model.value(), odometry_options(camera->calibration), pool.value().get());
  link::OdometryConfig mounting = link_settings(config, camera->calibration.T_body_cam).link.odometry;
  mounting.bench_metric = true;  // the test begins level, and looks at attitudes alone
  AttitudeTap tap(mounting.R_body_cam);
  PipelineOptions options;
  options.newest_frame = true;
  options.tap = &tap;
  NoSink sink;
  std::atomic<bool> done{false};
  rt::Thread pipeline;
  const auto started = pipeline.start("gw-tilt", {}, [&] {
    const auto run = run_pipeline(camera->camera.get(), stage.get(), pool.value().get(), options, &sink, done);
    static_cast<void>(run.ok());  // the sink refuses nothing
  });
  if (!started) return report->wrong("tilt test: " + started.error().message);
  const auto test = guide(service, &tap, mounting, stop);
  done.store(true, std::memory_order_relaxed);
  rt::join_in_time(&pipeline);
  if (!test) return report->wrong("tilt test: " + test.error().message);
  const std::vector<std::string> mistakes = test.value().result();
  for (const std::string& mistake : mistakes) report->wrong("tilt test: " + mistake);
  if (mistakes.empty()) report->fits("tilt test: the mounting agrees with the autopilot's attitude");
}

}  // namespace godwit::app
