#include "firmware_app/config/config_schema.h"

#include <algorithm>

#include "firmware_app/config/link_check.h"
#include "hal/rt/frame_pool.h"

namespace godwit::app {
namespace {

constexpr int kMostCpus = 1024;
constexpr int kHighestPriority = 98;  // 99 is the kernel's own: its watchdog and migration threads
constexpr std::size_t kLongestPath = 1024;

void add_thread(const std::string& section, rt::ThreadPlan* plan, std::vector<Key>* to) {
  to->push_back(keys::whole_list(section + ".cpus", 0, kMostCpus - 1, 64, &plan->cpus));
  to->push_back(keys::whole(section + ".priority", 0, kHighestPriority, &plan->priority));
}

void add_camera_device(Config* c, std::vector<Key>* to) {
  using Stamp = Config::Camera::Stamp;
  to->push_back(keys::text("camera.calibration", kLongestPath, "a file", &c->camera.calibration));
  to->push_back(keys::text("camera.device", kLongestPath,
                           "a path, by-id:NAME or serial:NUMBER; with libcamera index:N or an id", &c->camera.device));
  to->push_back(keys::text("camera.format", 4, "a pixel format", &c->camera.format));
  to->push_back(keys::number("camera.fps", 0, 1000, "Hz", &c->camera.fps));
  to->push_back(keys::whole("camera.shift", -1, 12, &c->camera.shift));
  to->push_back(keys::text("camera.controls", 1024, "NAME=NUMBER, ..", &c->camera.controls));
  to->push_back(keys::choice<Stamp>(
      "camera.stamp", {{"flags", Stamp::kFlags}, {"start", Stamp::kStart}, {"end", Stamp::kEnd}}, &c->camera.stamp));
  to->push_back(keys::number("camera.exposure_ms", 0, 1000, "ms", &c->camera.exposure_ms));
  using Exposure = Config::Camera::Exposure;
  to->push_back(keys::choice<Exposure>(
      "camera.exposure", {{"off", Exposure::kOff}, {"fixed", Exposure::kFixed}, {"automatic", Exposure::kAutomatic}},
      &c->camera.exposure));
  to->push_back(keys::number("camera.gain", 1, 1000, "", &c->camera.gain));
  to->push_back(keys::number("camera.brightness", 20, 200, "", &c->camera.brightness));
  to->push_back(keys::number("camera.blur_px", 0.1, 20, "pixels", &c->camera.blur_px));
  to->push_back(keys::number("camera.exposure_most_ms", 0, 1000, "ms", &c->camera.exposure_most_ms));
  to->push_back(keys::number("camera.gain_most", 1, 1000, "", &c->camera.gain_most));
  to->push_back(keys::text("camera.exposure_control", 64, "a control", &c->camera.exposure_control));
  to->push_back(keys::text("camera.gain_control", 64, "a control", &c->camera.gain_control));
  to->push_back(keys::number("camera.exposure_unit_us", 0, 100'000, "us", &c->camera.exposure_unit_us));
  to->push_back(keys::number("camera.gain_one", 0, 1e6, "", &c->camera.gain_one));
  to->push_back(keys::number("camera.gain_step_db", 0, 10, "dB", &c->camera.gain_step_db));
}

void add_imu(Config* c, std::vector<Key>* to) {
  using Source = Config::Imu::Source;
  to->push_back(keys::choice<Source>("imu.source",
                                     {{"none", Source::kNone},
                                      {"mpu6000", Source::kMpu6000},
                                      {"iio", Source::kIio},
                                      {"replay", Source::kReplay},
                                      {"sim", Source::kSim}},
                                     &c->imu.source));
  to->push_back(keys::flag("imu.enabled", &c->imu.enabled));
  to->push_back(keys::text("imu.calibration", kLongestPath, "a file", &c->imu.calibration));
  to->push_back(keys::number("imu.coast_s", 0, 10, "s", &c->imu.coast_s));
  to->push_back(keys::text("imu.device", kLongestPath, "a path or a name", &c->imu.device));
  to->push_back(keys::text("imu.accel_device", kLongestPath, "a name", &c->imu.accel_device));
  to->push_back(keys::whole("imu.rate_hz", 10, 1000, &c->imu.rate_hz));
  to->push_back(keys::whole("imu.gyro_range_deg_s", 250, 2000, &c->imu.gyro_range_deg_s));
  to->push_back(keys::whole("imu.accel_range_g", 2, 16, &c->imu.accel_range_g));
  to->push_back(keys::text("imu.axes", 16, "three axes such as x -y -z", &c->imu.axes));
  to->push_back(keys::flag("imu.self_test", &c->imu.self_test));
}

void add_aids(Config* c, std::vector<Key>* to) {
  to->push_back(keys::flag("aids.range", &c->aids.range));
  to->push_back(keys::flag("aids.barometer", &c->aids.barometer));
  to->push_back(keys::flag("aids.satellites", &c->aids.satellites));
  to->push_back(keys::flag("aids.attitude", &c->aids.attitude));
  to->push_back(keys::number("aids.starting_height_m", 0, 10000, "m", &c->aids.starting_height_m));
  to->push_back(keys::whole("aids.range_sensor", -1, 255, &c->aids.range_sensor));
  to->push_back(keys::number("aids.delay_ms", 0, 500, "ms", &c->aids.delay_ms));
}

void add_movers(Config* c, std::vector<Key>* to) {
  using Backend = detector::Backend;
  to->push_back(keys::flag("detector.enabled", &c->detector.enabled));
  to->push_back(keys::text("detector.model", kLongestPath, "a file", &c->detector.model));
  to->push_back(keys::text("detector.small_model", kLongestPath, "a file", &c->detector.small_model));
  to->push_back(keys::choice<Backend>(
      "detector.backend", {{"cpu", Backend::kCpu}, {"cuda", Backend::kCuda}, {"cuda_fp16", Backend::kCudaFp16}},
      &c->detector.backend));
  to->push_back(keys::number("detector.min_score", 0.05, 0.95, "", &c->detector.min_score));
  to->push_back(keys::flag("detector.tiled", &c->detector.tiled));
  to->push_back(keys::whole("detector.threads", 1, 64, &c->detector.threads));
  to->push_back(keys::flag("gate.enabled", &c->gate.enabled));
}

void add_link(Config* c, std::vector<Key>* to) {
  using Profile = Config::Link::Profile;
  using Arming = Config::Link::Arming;
  for (Key& key : std::vector<Key>{
           keys::text("can.bus", 64, "multicast:N or socketcan:IFACE", &c->can.bus),
           keys::whole("can.node_id", 0, 125, &c->can.node_id),
           keys::whole("can.autopilot_node", 1, 125, &c->can.autopilot_node),
           keys::whole("can.serial_index", 0, 15, &c->can.serial_index),
           keys::whole("can.baud_rate", 9600, 12'500'000, &c->can.baud_rate),
           keys::flag("can.fd", &c->can.fd),
           keys::whole("can.telemetry_rate", 0, 50, &c->can.telemetry_rate),
           keys::whole("can.telemetry_base", 0, 0x7F0, &c->can.telemetry_base),
           keys::flag("can.telemetry_fd", &c->can.telemetry_fd),
           keys::flag("can.lock_parameters", &c->can.lock_parameters),
           keys::whole_list("can.writers", 1, 127, 16, &c->can.writers),

           keys::text("link.mavlink", 256, "udp:HOST:PORT or serial:DEVICE:BAUD", &c->link.mavlink),
           keys::choice<Profile>("link.profile", {{"ardupilot", Profile::kArdupilot}, {"px4", Profile::kPx4}},
                                 &c->link.profile),
           keys::whole("link.rate", 20, 40, &c->link.rate),
           keys::flag("link.between_pictures", &c->link.between_pictures),
           keys::whole("link.system_id", 0, 255, &c->link.system_id),
           keys::choice<Arming>(
               "link.arming",
               {{"allow_without_pose", Arming::kAllowWithoutPose}, {"require_pose", Arming::kRequirePose}},
               &c->link.arming),
           keys::number_list("link.T_body_cam", 16, -100, 100, &c->link.T_body_cam),
           keys::number("link.world_heading_deg", -360, 360, "degree", &c->link.world_heading_deg),
           keys::flag("link.north_by_satellites", &c->link.north_by_satellites),
           keys::number_list("link.origin", 3, -20000, 20000, &c->link.origin),
           keys::flag("link.bench_metric", &c->link.bench_metric),
           keys::text("link.state_folder", kLongestPath, "a folder", &c->link.state_folder),

           keys::flag("flight_log.enabled", &c->flight_log.enabled),
           keys::text("flight_log.folder", kLongestPath, "a folder", &c->flight_log.folder),
           keys::whole("flight_log.budget_mb", 10, 1'000'000, &c->flight_log.budget_mb),

           keys::flag("recorder.enabled", &c->recorder.enabled),
           keys::text("recorder.folder", kLongestPath, "a folder", &c->recorder.folder),
           keys::number("recorder.before_s", 0.5, 60, "s", &c->recorder.before_s),
           keys::number("recorder.after_s", 0, 60, "s", &c->recorder.after_s),
           keys::whole("recorder.memory_mb", 10, 8000, &c->recorder.memory_mb),
           keys::whole("recorder.budget_mb", 10, 1'000'000, &c->recorder.budget_mb),
           keys::whole("recorder.events", 1, 1000, &c->recorder.events),

           keys::flag("live.enabled", &c->live.enabled),
           keys::text("live.socket", 107, "a path", &c->live.socket),
       }) {
    to->push_back(std::move(key));
  }
}

}  // namespace

std::vector<Key> config_keys(Config* c) {
  using Source = Config::Camera::Source;
  std::vector<Key> out = {
      keys::whole("pipeline.frame_slots", 0, rt::kMaxFrameSlots, &c->pipeline.frame_slots),
      keys::whole("pipeline.mapper_delay_frames", 1, 30, &c->pipeline.mapper_delay_frames),
      keys::whole("pipeline.detection_ms", 0, 5000, &c->pipeline.detection_ms),

      keys::flag("threads.lock_memory", &c->threads.lock_memory),
  };
  add_thread("threads.camera", &c->threads.camera, &out);
  add_thread("threads.imu", &c->threads.imu, &out);
  add_thread("threads.tracker", &c->threads.tracker, &out);
  add_thread("threads.mapper", &c->threads.mapper, &out);
  add_thread("threads.detector", &c->threads.detector, &out);
  add_thread("threads.link", &c->threads.link, &out);
  for (Key& key : std::vector<Key>{
           keys::number("scheduler.deadline_ms", 5, 1000, "ms", &c->scheduler.deadline_ms),
           keys::number("scheduler.tracker_p95_ms", 1, 1000, "ms", &c->scheduler.tracker_p95_ms),
           keys::number("scheduler.temperature_c", 30, 120, "degrees C", &c->scheduler.temperature_c),
           keys::number("scheduler.calm_s", 1, 600, "s", &c->scheduler.calm_s),

           keys::choice<Source>("camera.source",
                                {{"none", Source::kNone},
                                 {"sim", Source::kSim},
                                 {"replay", Source::kReplay},
                                 {"v4l2", Source::kV4l2},
                                 {"libcamera", Source::kLibcamera}},
                                &c->camera.source),
           keys::text("camera.sequence", kLongestPath, "a folder", &c->camera.sequence),
           keys::flag("camera.allow_simulated", &c->camera.allow_simulated),
           keys::text("camera.scenario", kLongestPath, "a scenario's name or file", &c->camera.scenario),
           keys::text("camera.scenarios", kLongestPath, "a folder", &c->camera.scenarios),
           keys::whole<std::uint64_t>("camera.seed", 0, 1'000'000'000, &c->camera.seed),
           keys::whole("camera.pictures", 2, 10000, &c->camera.pictures),
       }) {
    out.push_back(std::move(key));
  }
  add_camera_device(c, &out);
  add_movers(c, &out);
  add_imu(c, &out);
  out.push_back(keys::number("imu.silent_s", 0.02, 10, "s", &c->imu.silent_s));
  add_aids(c, &out);
  add_link(c, &out);
  return out;
}

namespace {

/// A recorded sensor goes with the pictures that were recorded with it.
void check_imu_source(ConfigReport* report) {
  using Source = Config::Imu::Source;
  using Camera = Config::Camera::Source;
  const Config& c = report->config;
  const auto goes_with = [&](Source source, Camera camera, const char* name) {
    if (c.imu.source != source || c.camera.source == camera) return;
    report->mistake("imu.source", std::string("\"") + name + "\" is the sensor of camera.source = \"" + name +
                                      "\"; with another camera \"mpu6000\", \"iio\" or \"none\" is allowed");
  };
  goes_with(Source::kReplay, Camera::kReplay, "replay");
  goes_with(Source::kSim, Camera::kSim, "sim");
  const bool device = c.imu.source == Source::kMpu6000 || c.imu.source == Source::kIio;
  const bool not_now = c.camera.source == Camera::kReplay || c.camera.source == Camera::kSim;
  if (device && not_now && c.imu.enabled) {
    report->mistake("imu.source",
                    "it measures what happens now, and the camera's pictures do not: nothing fits together; "
                    "imu.enabled = false only watches it");
  }
}

}  // namespace

void check_contradictions(ConfigReport* report) {
  const Config& c = report->config;
  const auto behind_tracker = [&](const char* key, int priority) {
    if (priority == 0 || priority < c.threads.tracker.priority) return;
    const int most = std::max(0, c.threads.tracker.priority - 1);
    report->mistake(
        key, "tracking comes first, with threads.tracker.priority = " + std::to_string(c.threads.tracker.priority) +
                 "; 0 to " + std::to_string(most) + " is allowed");
  };
  behind_tracker("threads.mapper.priority", c.threads.mapper.priority);
  behind_tracker("threads.detector.priority", c.threads.detector.priority);
  if (c.scheduler.tracker_p95_ms >= c.scheduler.deadline_ms) {
    report->mistake("scheduler.tracker_p95_ms", keys::decimal(c.scheduler.tracker_p95_ms) +
                                                    " is not below scheduler.deadline_ms (" +
                                                    keys::decimal(c.scheduler.deadline_ms) +
                                                    "): it would act only when it is too late; less is allowed");
  }
  if (c.recorder.memory_mb > c.recorder.budget_mb) {
    report->mistake("recorder.memory_mb", std::to_string(c.recorder.memory_mb) +
                                              " MB in memory may make an event of which recorder.budget_mb (" +
                                              std::to_string(c.recorder.budget_mb) +
                                              ") holds none; no more than that is allowed");
  }
  check_imu_source(report);
  check_link(report);
}

}  // namespace godwit::app
