// Writes a flight that pyulog_test.py knows: write_flight FOLDER
#include "firmware_app/output/flight_log.h"

int main(int count, char** arguments) {
  using namespace godwit;
  if (count != 2) return 2;
  app::FlightLogOptions options;
  options.folder = arguments[1];
  options.info = {{"ver_sw", "1.2.3"}, {"version", "1.2"}, {"configuration", "camera.source = \"none\""}};
  app::FlightLog log(options);
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
    log.frame(r);
  }
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
