// Writes a flight that pyulog_test.py knows: write_flight FOLDER
#include <chrono>
#include <thread>

#include "firmware_app/output/flight_log.h"

int main(int count, char** arguments) {
  using namespace godwit;
  if (count != 2) return 2;
  app::FlightLogOptions options;
  options.folder = arguments[1];
  options.info = {{"ver_sw", "1.2.3"}, {"version", "1.2"}, {"configuration", "camera.source = \"none\""}};
  options.parameters = {{"camera.fps", 30}, {"tracker.gain", 0.25}};
  app::FlightLog log(options);
  // The log's own thread looks at the machine once a second, first of all: this flight may be over before it begins.
  while (log.report().written_bytes == 0) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  for (std::uint32_t i = 0; i < 30; ++i) {
    app::FrameRecord r;
    r.sequence = i;
    r.t_capture_ns = 1'000'000'000 + i * 33'000'000LL;
    r.t_delivered_ns = r.t_capture_ns + 1'000'000;
    r.t_done_ns = r.t_capture_ns + 5'000'000;
    r.features = 100 + static_cast<std::int32_t>(i);
    r.thread_cpu_ns = 1'500'000;
    r.stage_ns[3] = 250'000;
    r.stage_ns[7] = 750'000;
    r.tracked = r.has_pose = i >= 10;
    r.is_keyframe = i == 12;
    r.map_id = i >= 10 ? 1 : 0;
    r.t_world_cam = {i * 0.1, -1.0, 2.5};
    r.q_world_cam = {0, 0, 0, 1};
    for (std::size_t k = 0; k < 21; ++k) r.covariance[k] = static_cast<double>(k);
    r.reference_id = 3;
    r.t_reference_ns = 999'000'000;
    r.median_depth = 4.5;
    r.metric = i >= 20;
    if (i % 5 == 0) {
      r.mapping.messages = 2;
      r.mapping.points = 1000;
      r.mapping.outliers = 7;
    }
    r.state = i >= 10 ? vo::State::kTracking : vo::State::kInitialising;
    r.load.known = i >= 5;
    r.load.rung = i >= 15 ? app::Rung::kLongPeriod : app::Rung::kFull;
    r.load.slips = i;
    r.load.mask_age_ns = i >= 20 ? 120'000'000 : -1;
    r.load.mapper_backlog = 2;
    r.load.readings_waiting = 7;
    r.load.slots_free = 9;
    r.load.slots_fewest = 4;
    r.t_source_ns = r.t_capture_ns - 2'000'000;
    r.order = {.number = i + 1,
               .room = 3,
               .deltas = static_cast<std::int32_t>(i % 2),
               .feature_share = i >= 15 ? 0.5 : 1.0,
               .t_detection_ns = i == 14 ? 1'400'000'000 : 0,
               .readings = 6ULL * i,
               .t_reading_ns = r.t_capture_ns - 3'000'000};
    for (int k = 0; k < 6; ++k) {
      hal::ImuSample s;
      s.t_ns = r.t_capture_ns + k * 5'000'000;
      s.gyro_rad_s = {0.5, -0.25, i * 0.125};
      s.accel_m_s2 = {0, 0, -9.8125};
      s.flags = i == 3 ? hal::kImuGap : 0;
      log.reading(s);
    }
    log.frame(r);
  }
  app::FoundBoxes found;
  found.t_capture_ns = 1'400'000'000;
  found.boxes.push({.x0 = 10, .y0 = 20, .x1 = 110.5, .y1 = 220, .score = 0.75F, .class_id = 2});
  found.boxes.push({.x0 = 1, .y0 = 2, .x1 = 3, .y1 = 4, .score = 0.5F, .class_id = 7});
  log.detection(found);
  link::LinkStatus bus;
  bus.t_ns = 1'600'000'000;
  bus.odometry_sent = 17;
  bus.tx.abandoned = 3;
  bus.bus.sent = 1234;
  bus.bus.bus_off = 1;
  bus.bus_load_percent = 17.5;
  bus.latency.p99_ms = 21.5;
  bus.quality = -1;
  bus.reset_counter = 250;
  bus.bus_state = hal::CanState::kBusOff;
  bus.autopilot_alive = true;
  log.bus(bus);
  rt::LogEntry lost;
  lost.t_ns = 1'500'000'000;
  lost.level = rt::LogLevel::kWarning;
  lost.what = "state";
  lost.before = "TRACKING";
  lost.which = "LOST";
  log.event(lost);
  const app::FlightLogReport report = log.finish(60 * rt::kNsPerSecond);
  return report.dropped == 0 && report.trouble.empty() ? 0 : 1;
}
