#include "firmware_app/commands/fly_command.h"

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <thread>

#include "firmware_app/commands/camera_run.h"
#include "firmware_app/commands/exit_code.h"
#include "firmware_app/output/atomic_file.h"
#include "firmware_app/output/flight_writer.h"

namespace godwit::app {
namespace {

/// The simulated camera with a pace and a last picture; keeps the true boxes of what was seen.
class FlownCamera final : public hal::Camera {
 public:
  FlownCamera(const sim::Flight& flight, const ReplayArguments& run)
      : camera_(flight.camera(0)),
        real_(run.pace == "real"),
        first_(static_cast<int>(std::min<std::int64_t>(run.start, camera_->frames()))),
        left_(camera_->frames() - first_) {
    if (run.frames > 0) left_ = static_cast<int>(std::min<std::int64_t>(run.frames, left_));
    camera_->skip_to(first_);
    boxes_ = boxes_head();
  }
  int width() const override { return camera_->width(); }
  int height() const override { return camera_->height(); }
  int channels() const override { return camera_->channels(); }
  hal::CameraStatus next(const rt::MutableImageView& grey, std::uint8_t* bgr, rt::TimeNs timeout_ns,
                         hal::CapturedFrame* frame, std::string* why) override {
    if (left_ == 0) return hal::CameraStatus::kEnd;
    --left_;
    const hal::CameraStatus status = camera_->next(grey, bgr, timeout_ns, frame, why);
    frame->sequence -= static_cast<std::uint32_t>(first_);
    if (status == hal::CameraStatus::kFrame && grey.data != nullptr)
      boxes_ += boxes_lines(*camera_, frame->t_source_ns);
    if (real_) {
      // The picture was drawn ahead; it is there when its exposure is over, on the clock that began with the first.
      if (start_ns_ == 0) start_ns_ = rt::monotonic_now_ns() - frame->t_source_ns;
      frame->t_capture_ns = start_ns_ + frame->t_source_ns;
      const rt::TimeNs wait = frame->t_capture_ns - rt::monotonic_now_ns();
      if (wait > 0) std::this_thread::sleep_for(std::chrono::nanoseconds(wait));
    }
    return status;
  }
  int left() const { return left_; }
  const std::string& boxes() const { return boxes_; }

 private:
  std::unique_ptr<sim::SimCamera> camera_;
  const bool real_;
  const int first_;
  int left_;
  rt::TimeNs start_ns_ = 0;
  std::string boxes_;
};

hal::CameraCalibration calibration_of(const sim::Flight& flight) {
  const sim::CameraPlan& plan = flight.scenario().camera;
  hal::CameraCalibration c;
  c.width = plan.rig.lens.width;
  c.height = plan.rig.lens.height;
  c.fx = plan.rig.lens.fx;
  c.fy = plan.rig.lens.fy;
  c.cx = plan.rig.lens.cx;
  c.cy = plan.rig.lens.cy;
  c.distortion = plan.rig.lens.distortion;
  c.fps = plan.fps;
  c.readout_frames = plan.rig.readout_s * plan.fps;
  std::array<double, 16> T{};
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) T[static_cast<std::size_t>(4 * i + j)] = plan.rig.R_body_cam(i, j);
    T[static_cast<std::size_t>(4 * i + 3)] = plan.rig.t_body_cam_m[i];
  }
  T[15] = 1;
  c.T_body_cam = T;
  return c;
}

rt::Result<void> write_truth(const sim::Flight& flight, const FlownCamera& camera, const std::string& out) {
  std::error_code error;
  std::filesystem::create_directories(out, error);
  if (error) return rt::Error{out + ": cannot make the folder: " + error.message()};
  // The run's times count from the flight's start.
  if (auto r = write_ground_truth(flight, out + "/groundtruth.txt", 0); !r) return r;
  AtomicFile file;
  if (auto r = file.open(out + "/boxes.csv"); !r) return r;
  if (auto r = file.write(camera.boxes()); !r) return r;
  return file.commit();
}

}  // namespace

void add_fly_command(CLI::App* app, FlyArguments* a) {
  CLI::App* command = app->add_subcommand("fly", "Fly a simulated scenario: a pose for every frame out, and the truth");
  add_flight_options(command, &a->flight);
  add_run_options(command, &a->run);
  command->footer(
      "Writes what replay writes (trajectory.tum, frames.csv, pose.csv, summary.json), and groundtruth.txt and "
      "boxes.csv.\n"
      "Example: godwit fly street --seed 7 --out out/street");
}

int run_fly(const FlyArguments& a, const std::atomic<bool>& stop) {
  Config config;
  if (!check_run_arguments(a.run, &config)) return kExitRefused;
  const auto flight = make_flight(a.flight);
  if (!flight) return refuse(flight.error().message);
  FlownCamera camera(*flight.value(), a.run);
  if (camera.left() == 0)
    return refuse("--start " + std::to_string(a.run.start) + ": the flight has no more pictures than that");
  CameraRunPlan plan;
  plan.source = a.flight.scenario + ", seed " + std::to_string(a.flight.seed);
  plan.calibration_name = "scenario " + a.flight.scenario;
  plan.out = a.run.out;
  plan.pace = a.run.pace;
  plan.sequential = a.run.sequential;
  plan.start = a.run.start;
  plan.total = camera.left();
  const int code = run_camera(&camera, calibration_of(*flight.value()), config, plan, stop);
  if (code != kExitDone) return code;
  if (const auto written = write_truth(*flight.value(), camera, a.run.out); !written)
    return failed(written.error().message);
  return kExitDone;
}

}  // namespace godwit::app
