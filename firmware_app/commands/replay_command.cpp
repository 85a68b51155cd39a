#include "firmware_app/commands/replay_command.h"

#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <CLI/Validators.hpp>
#include <algorithm>
#include <fmt/format.h>
#include <memory>

#include "firmware_app/commands/camera_run.h"
#include "firmware_app/commands/written_calibration.h"
#include "firmware_app/config/config.h"
#include "firmware_app/config/link_check.h"
#include "firmware_app/config/link_settings.h"
#include "firmware_app/link/byte_port.h"
#include "firmware_app/program/exit_code.h"
#include "firmware_app/program/numbers.h"
#include "hal/aid/replay/replay_aids.h"
#include "hal/camera/replay/replay_camera.h"
#include "hal/can/can_bus.h"
#include "hal/imu/replay/replay_imu.h"

namespace godwit::app {
namespace {

/// Against what moves: a flag that is given wins over the file. What neither names is off, whatever its default in
/// flight: a replay measures what it is told to.
void take_mover_options(const ReplayArguments& a, const ConfigReport& file, Config* config) {
  const auto wanted = [&](const std::string& flag, const char* key, bool configured) {
    return flag.empty() ? configured && file.lines.contains(key) : flag == "on";
  };
  config->detector.enabled = wanted(a.detector, "detector.enabled", config->detector.enabled);
  config->gate.enabled = wanted(a.gate, "gate.enabled", config->gate.enabled);
  if (a.model.empty()) return;
  config->detector.model = a.model;
  config->detector.small_model.clear();
}

/// As of a recording of a machine that died, which is flown as far as it is whole.
void warn(const std::string& words) {
  if (!words.empty()) fmt::print(stderr, "godwit: warning: {}\n", words);
}

}  // namespace

void add_replay_command(CLI::App* app, ReplayArguments* a) {
  CLI::App* replay = app->add_subcommand("replay", "Fly a recorded sequence: a pose for every frame out");
  replay
      ->add_option(
          "SEQUENCE", a->sequence,
          "Folder in TUM layout (rgb.txt, pictures, camera.yaml) or EuRoC/ASL layout (mav0/cam0 with data.csv, "
          "data/ and sensor.yaml; mav0 or cam0 itself will do); or a video, or a folder of KITTI's odometry benchmark "
          "(image_0/ or image_2/, times.txt, calib.txt), which becomes a sequence in OUT/sequence first")
      ->required();
  replay->add_option("--camera", a->video.calibration, "With a video: its camera's calibration (camera.yaml)")
      ->type_name("FILE");
  replay
      ->add_option("--fov", a->video.fov_deg,
                   "With a video, for a first look without a calibration: the horizontal field of view in degrees")
      ->type_name("DEG")
      ->check(CLI::Range(10.0, 150.0));
  replay
      ->add_option("--loop", a->loop,
                   "Fly the sequence N times, forth and back in turn, with times that go on: a long flight without a "
                   "jump (a rolling shutter's readout is right on the way forth only)")
      ->type_name("N")
      ->check(whole_number(1, 1'000'000))
      ->capture_default_str();
  replay
      ->add_option("--write-calibration", a->write_calibration,
                   "With --imu on or watch: write the sequence's calibration (TOML) with rotation and time offset "
                   "between camera and IMU as this flight shows them; needs turns about all three axes")
      ->type_name("FILE");
  add_run_options(replay, a);
  replay->footer(
      "Writes trajectory.tum, frames.csv, pose.csv and summary.json; summary.json comes last, so a folder that\n"
      "has one is whole.\n"
      "Example: godwit replay ../shared/data/tum_fr1_xyz --sequential --out out/fr1");
}

void add_run_options(CLI::App* command, ReplayArguments* a) {
  command->add_option("--config", a->config_file, "Configuration (TOML); config/godwit.toml lists every key")
      ->type_name("FILE");
  command->add_option("--out", a->out, "Folder for the results, made if it is not there")
      ->type_name("DIR")
      ->capture_default_str();
  command
      ->add_option(
          "--pace", a->pace,
          "max: as fast as it goes, nothing is dropped; real: pictures come at their capture times, and a frame "
          "that finds the tracker busy gives way to the next")
      ->check(CLI::IsMember({"max", "real"}))
      ->capture_default_str();
  command->add_flag("--sequential", a->sequential,
                    "All stages in one thread in a fixed order: two runs are equal to the bit");
  add_range_options(command, &a->start, &a->frames);
  const auto on_off = [&](const char* name, std::string* value, const char* what) {
    command->add_option(name, *value, what)->check(CLI::IsMember({"on", "off"}));
  };
  on_off("--detector", &a->detector,
         "Find what may move by a network and leave it out (default: as detector.enabled in the file of --config, off "
         "where that does not say)");
  on_off("--gate", &a->gate, "Find what moves by geometry and leave it out (default: the same with gate.enabled)");
  command
      ->add_option(
          "--imu", a->imu,
          "on: poses in metres, z up, in one frame through losses and new maps, once the IMU has shown both; frames "
          "before that not tracked (docs/inertial.md); watch: read it beside the camera and, but for --sequential, "
          "tell "
          "when it is silent")
      ->check(CLI::IsMember({"on", "watch", "off"}))
      ->capture_default_str();
  command
      ->add_option("--aids", a->aids,
                   "What else tells lengths: range, baro, gnss, with commas between; from range.csv, baro.csv and "
                   "gnss.csv beside the pictures. Without --imu on, attitude among them tells the vertical, from an "
                   "autopilot's attitude.csv (docs/inertial.md)")
      ->type_name("LIST");
  command
      ->add_option("--model", a->model,
                   "The detector's network, for the large input and the small one (default: detector.model)")
      ->type_name("FILE");
  command
      ->add_option("--view", a->view,
                   "Folder for pictures of what was seen: the picture, its dynamic pixels, and the features behind the "
                   "pose (corners green, edgelets yellow, inside the mask blue)")
      ->type_name("DIR");
  command->add_option("--view-every", a->view_every, "A picture for every N-th frame")
      ->type_name("N")
      ->check(whole_number(1, kManyPictures))
      ->capture_default_str();
  command
      ->add_option(
          "--events", a->events,
          "Folder for the event recorder, made if it is not there: pictures and readings around each loss, new "
          "map and doubt, and at SIGUSR1, as sequences that replay takes; seconds, memory and budgets are "
          "[recorder]'s in the file of --config")
      ->type_name("DIR");
  command
      ->add_option(
          "--log", a->log,
          "Folder for a flight log (ULog; docs/flight-log.md), made if it is not there; --as-flown flies by it")
      ->type_name("DIR");
  command
      ->add_option(
          "--as-flown", a->as_flown,
          "Fly the same pictures again by this flight log, which --log wrote: each frame finds what it found then, so "
          "that on the same machine its poses are the same to the bit, which is looked at (exit code 1: they are not); "
          "refused where the log has a gap, unless --frames stays before it")
      ->type_name("LOG");
  add_link_options(command, &a->can, &a->mavlink);
  command->add_flag("--bench-metric", a->bench_metric,
                    "The map's lengths pass for metres and its start for level, so that the autopilot takes the poses "
                    "as good ones; for the bench only");
}

void add_link_options(CLI::App* command, std::string* can, std::string* mavlink) {
  command
      ->add_option("--can", *can,
                   "CAN bus to the autopilot: multicast:N (UDP, as ArduPilot's simulator) or socketcan:IFACE")
      ->type_name("BUS");
  command->add_option("--mavlink", *mavlink, "MAVLink beside the bus: udp:HOST:PORT[:LOCALPORT] or serial:DEVICE:BAUD")
      ->type_name("PORT");
}

bool take_link_options(const std::string& can, const std::string& mavlink, Config* config) {
  if (can.empty() && mavlink.empty()) return true;
  if (const auto known = hal::check_can_address(can); !can.empty() && !known) {
    refuse("--can: " + known.error().message);
    return false;
  }
  if (const auto known = link::check_byte_port_address(mavlink); !mavlink.empty() && !known) {
    refuse("--mavlink: " + known.error().message);
    return false;
  }
  ConfigReport report;
  report.config = *config;
  report.file = "with --can, --mavlink";
  if (!can.empty()) report.config.can.bus = can;
  if (!mavlink.empty()) report.config.link.mavlink = mavlink;
  check_link(&report);
  for (const std::string& mistake : report.mistakes) refuse(mistake);
  *config = report.config;
  return report.ok();
}

bool check_run_arguments(const ReplayArguments& a, Config* config) {
  if (a.sequential && a.pace == "real") {
    refuse("--sequential has no pace: leave --pace real out");
    return false;
  }
  if (!a.as_flown.empty() && (a.sequential || a.pace == "real" || !a.events.empty())) {
    refuse("--as-flown: the log says what came when; leave --sequential, --pace real and --events out");
    return false;
  }
  if (a.out.empty()) {
    refuse("--out: a folder is needed");
    return false;
  }
  if (!a.view.empty() && a.pace == "real") {
    refuse("--view: writing pictures takes time that the tracker has not at real pace; leave --pace real out");
    return false;
  }
  ConfigReport report;
  if (!a.config_file.empty()) {
    report = load_config(a.config_file);
    for (const std::string& mistake : report.mistakes) refuse(mistake);
    if (!report.ok()) return false;
    *config = report.config;
  }
  take_mover_options(a, report, config);
  if (!a.model.empty() && !config->detector.enabled) {
    refuse("--model: is for the detector; add --detector on");
    return false;
  }
  if (!take_link_options(a.can, a.mavlink, config)) return false;
  if (a.bench_metric) config->link.bench_metric = true;
  if (a.bench_metric && !wants_link(*config)) {
    refuse("--bench-metric: there is nobody to tell; it goes with --can or --mavlink, or with the configuration's");
    return false;
  }
  if (wants_link(*config) && a.pace != "real") {
    refuse("--can, --mavlink: an autopilot takes poses when they happen; add --pace real");
    return false;
  }
  if (config->link.bench_metric && a.imu == "on") {
    refuse("--bench-metric takes for metres what --imu on measures in metres: leave one of them out");
    return false;
  }
  if (const auto kinds = hal::parse_aid_kinds(a.aids); !kinds) {
    refuse("--aids " + kinds.error().message);
    return false;
  }
  if (!a.aids.empty() && !a.as_flown.empty()) {
    refuse("--as-flown with --aids: the log does not hold when which of them was heard");
    return false;
  }
  if (!a.aids.empty() && a.imu != "on" && !tells_attitude(a)) {
    refuse("--aids: without --imu on the vertical is missing: add attitude to the list");
    return false;
  }
  if (a.imu == "on" && tells_attitude(a)) {
    refuse("--aids attitude with --imu on: the IMU tells the vertical; leave one of them out");
    return false;
  }
  if (config->link.bench_metric && tells_attitude(a)) {
    refuse("--bench-metric takes for metres what --aids measure in metres: leave one of them out");
    return false;
  }
  // What flies here is the sequence's or the scenario's own sensor, not the file's.
  config->imu.enabled = a.imu == "on";
  config->imu.source = a.imu == "on" ? Config::Imu::Source::kReplay : Config::Imu::Source::kNone;
  return true;
}

bool tells_attitude(const ReplayArguments& a) {
  const auto kinds = hal::parse_aid_kinds(a.aids);
  return kinds.ok() &&
         std::find(kinds.value().begin(), kinds.value().end(), hal::AidKind::kAttitude) != kinds.value().end();
}

int run_replay(const ReplayArguments& a, const std::atomic<bool>& stop) {
  Config config;
  if (!check_run_arguments(a, &config)) return kExitRefused;
  const auto sequence = as_sequence(a.sequence, a.video, a.out, stop);
  if (!sequence) {
    const int code = refuse(sequence.error().message);
    return stop.load(std::memory_order_relaxed) ? kExitInterrupted : code;
  }

  hal::ReplayOptions replay;
  replay.pace = a.pace == "real" ? hal::ReplayOptions::Pace::kReal : hal::ReplayOptions::Pace::kMax;
  replay.start = a.start;
  replay.frames = a.frames;
  replay.passes = a.loop;
  hal::ReplayTime time;
  replay.time = &time;
  auto camera = hal::ReplayCamera::open(sequence.value(), replay);
  if (!camera) return refuse(camera.error().message);
  warn(camera.value()->cut_off());
  std::unique_ptr<hal::ReplayImu> imu;
  hal::ImuErrorModel imu_errors;
  std::vector<hal::ImuSample> readings;
  if (!a.write_calibration.empty() && a.imu == "off") {
    return refuse("--write-calibration: how the IMU turned must be known; add --imu on or --imu watch");
  }
  if (a.imu != "off") {
    if (a.loop > 1) return refuse("--imu with --loop: nobody measured the way back");
    auto record = hal::read_imu_record(sequence.value());
    if (!record) return refuse(record.error().message);
    for (const std::string& words : record.value().warnings(sequence.value())) warn(words);
    imu_errors = record.value().errors;
    if (!a.write_calibration.empty()) readings = record.value().samples;
    imu = std::make_unique<hal::ReplayImu>(std::move(record).value(), &time, a.pace == "real");
  }
  std::unique_ptr<hal::ReplayAids> aids;
  if (!a.aids.empty()) {
    std::vector<std::string> cut_off;
    auto record = hal::read_aid_record(sequence.value(), hal::parse_aid_kinds(a.aids).value(), &cut_off);
    if (!record) return refuse("--aids: " + record.error().message);
    for (const std::string& words : cut_off) warn(words);
    aids = std::make_unique<hal::ReplayAids>(std::move(record).value(), &time);
  }
  const hal::CameraCalibration& calibration = camera.value()->calibration();
  CameraRunPlan plan;
  static_cast<RunOptions&>(plan) = a;
  plan.source = sequence.value();
  plan.calibration_name = camera.value()->layout().calibration_file;
  plan.total = camera.value()->total();
  plan.imu = imu.get();
  plan.aids = aids.get();
  plan.inertial = a.imu == "on";
  plan.imu_errors = imu_errors;
  plan.aided = tells_attitude(a);
  if (a.write_calibration.empty()) return run_camera(camera.value().get(), calibration, config, plan, stop);
  TurnListener turns;
  plan.beside = &turns;
  plan.gyro_helps = false;
  if (const int code = run_camera(camera.value().get(), calibration, config, plan, stop); code != kExitDone)
    return code;
  const auto written = write_camera_imu(a.write_calibration, calibration, turns.turns(), readings);
  return written ? kExitDone : failed("--write-calibration: " + written.error().message);
}

}  // namespace godwit::app
