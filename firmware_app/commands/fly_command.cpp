#include "firmware_app/commands/fly_command.h"

#include <filesystem>
#include <fmt/format.h>
#include <memory>

#include "firmware_app/commands/camera_run.h"
#include "firmware_app/program/exit_code.h"
#include "firmware_app/sim/flight_aids.h"
#include "firmware_app/sim/flight_calibration.h"
#include "firmware_app/sim/flight_imu.h"
#include "firmware_app/sim/flight_writer.h"
#include "firmware_app/sim/flown_camera.h"
#include "hal/aid/replay/replay_aids.h"
#include "hal/atomic_file.h"
#include "hal/imu/replay/replay_imu.h"

namespace godwit::app {
namespace {

rt::Result<void> write_truth(const sim::Flight& flight, const FlownCamera& camera, const std::string& out) {
  std::error_code error;
  std::filesystem::create_directories(out, error);
  if (error) return rt::Error{out + ": cannot make the folder: " + error.message()};
  // The run's times count from the flight's start.
  if (auto r = write_ground_truth(flight, out + "/groundtruth.txt", 0); !r) return r;
  if (auto r = write_sensors(flight, out, 0); !r) return r;
  hal::AtomicFile file;
  if (auto r = file.open(out + "/boxes.csv"); !r) return r;
  if (auto r = file.write(camera.boxes()); !r) return r;
  return file.commit();
}

}  // namespace

void add_fly_command(CLI::App* app, FlyArguments* a) {
  CLI::App* command = app->add_subcommand("fly", "Fly a simulated scenario: a pose for every frame out, and the truth");
  add_flight_options(command, &a->flight);
  add_run_options(command, &a->run);
  command->add_flag("--truth-masks", a->truth_masks,
                    "Leave the true boxes of people, cars and trucks out, as a detector without fault would");
  command->add_flag("--render-ahead", a->render_ahead,
                    "Draw all pictures into memory first, so that the flight has the processor for itself");
  command->footer(
      "Writes what replay writes (trajectory.tum, frames.csv, pose.csv, summary.json), and the truth: groundtruth.txt\n"
      "(camera), groundtruth_body.txt, boxes.csv, imu.csv, range.csv, gnss.csv, baro.csv, attitude.csv.\n"
      "Example: godwit fly street --seed 7 --out out/street");
}

int run_fly(const FlyArguments& a, const std::atomic<bool>& stop) {
  Config config;
  if (!check_run_arguments(a.run, &config)) return kExitRefused;
  if (a.truth_masks && (a.run.detector == "on" || !a.run.model.empty()))
    return refuse("--truth-masks and --detector on: one of them gives the masks");
  if (a.truth_masks) config.detector.enabled = false;
  const auto flight = make_flight(a.flight);
  if (!flight) return refuse(flight.error().message);
  if (const std::string& title = flight.value()->scenario().title; !title.empty())
    fmt::print(stderr, "{}, seed {}: {}\n", a.flight.scenario, a.flight.seed, title);
  hal::ReplayTime time;
  FlownCamera camera(*flight.value(), {a.run.start, a.run.frames, a.run.pace == "real", a.truth_masks, &time});
  std::unique_ptr<hal::ReplayImu> imu;
  hal::ImuErrorModel imu_errors;
  if (a.run.imu != "off") {
    hal::ImuRecord record = imu_record_of(*flight.value());
    imu_errors = record.errors;
    imu = std::make_unique<hal::ReplayImu>(std::move(record), &time, a.run.pace == "real");
  }
  std::unique_ptr<hal::ReplayAids> aids;
  if (!a.run.aids.empty()) {
    aids = std::make_unique<hal::ReplayAids>(aid_record_of(*flight.value(), hal::parse_aid_kinds(a.run.aids).value()),
                                             &time);
  }
  if (camera.left() == 0)
    return refuse("--start " + std::to_string(a.run.start) + ": the flight has no more pictures than that");
  CameraRunPlan plan;
  static_cast<RunOptions&>(plan) = a.run;
  plan.source = a.flight.scenario + ", seed " + std::to_string(a.flight.seed);
  plan.calibration_name = "scenario " + a.flight.scenario;
  plan.total = camera.left();
  plan.masks = camera.masks();
  plan.imu = imu.get();
  plan.aids = aids.get();
  plan.inertial = a.run.imu == "on";
  plan.imu_errors = imu_errors;
  plan.aided = tells_attitude(a.run);
  if (a.render_ahead) {
    if (const auto drawn = camera.render_ahead(stop); !drawn) {
      if (!stop.load(std::memory_order_relaxed)) return refuse(drawn.error().message);
      failed(drawn.error().message);
      return kExitInterrupted;
    }
  }
  const int code = run_camera(&camera, calibration_of(*flight.value()), config, plan, stop);
  if (code != kExitDone) return code;
  if (const auto written = write_truth(*flight.value(), camera, a.run.out); !written)
    return failed(written.error().message);
  return kExitDone;
}

}  // namespace godwit::app
