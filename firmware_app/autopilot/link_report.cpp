#include <fmt/format.h>

#include "firmware_app/autopilot/link_runner.h"

namespace godwit::app {

std::vector<std::string> link_report(const link::LinkStatus& s) {
  std::vector<std::string> lines;
  if (s.latency.samples >= link::LatencyMonitor::kMinSamples) {
    lines.push_back(fmt::format(
        "capture to autopilot: p50 {:.1f} ms, p99 {:.1f} ms{}; VISO_DELAY_MS {}", s.latency.p50_ms, s.latency.p99_ms,
        s.synchronised ? "" : ", without the way there (nobody answers TIMESYNC)", s.latency.viso_delay_ms));
  } else {
    lines.push_back("capture to autopilot: too few poses of quality 1 or better were sent to tell");
  }
  if (s.own_samples > 0) {
    lines.push_back(fmt::format("our own share, from pose to last frame: p50 {:.2f} ms, p99 {:.2f} ms, most {:.2f} ms",
                                s.own_p50_ms, s.own_p99_ms, s.own_max_ms));
  }
  lines.push_back(
      fmt::format("{} ODOMETRY sent, {} passed over for a newer one, {} stale; bus "
                  "load {:.1f} %",
                  s.odometry_sent, s.poses_paced, s.poses_stale, s.bus_load_percent));
  const std::uint64_t lost = s.tx.poses_replaced + s.tx.refused + s.tx.abandoned;
  if (lost + s.bus.bus_off + s.bus.reopened + s.reception.errors() > 0) {
    lines.push_back(
        fmt::format("sending: {} messages dropped whole, {} of them poses; bus-off {} times, opened again {} times; "
                    "{} frames of others could not be put together",
                    lost, s.tx.poses_replaced, s.bus.bus_off, s.bus.reopened, s.reception.errors()));
  }
  return lines;
}

std::string link_report_json(const link::LinkStatus& s) {
  const bool known = s.latency.samples >= link::LatencyMonitor::kMinSamples;
  const auto ms = [&](double value) { return known ? fmt::format("{:.3f}", value) : std::string("null"); };
  const auto own = [&](double value) { return s.own_samples > 0 ? fmt::format("{:.3f}", value) : std::string("null"); };
  return fmt::format(
      R"({{"node_id": {}, "odometry_sent": {}, "poses_paced": {}, "poses_stale": {}, "poses_replaced": {}, )"
      R"("messages_refused": {}, "messages_abandoned": {}, "reception_errors": {}, "bus_off": {}, "reopened": {}, )"
      R"("reset_counter": {}, "bus_load_percent": {:.2f}, "timesync": {}, "round_trip_ms": {:.3f}, )"
      R"("latency_p50_ms": {}, "latency_p99_ms": {}, "viso_delay_ms": {}, )"
      R"("own_p50_ms": {}, "own_p99_ms": {}, "own_max_ms": {}}})",
      s.node_id, s.odometry_sent, s.poses_paced, s.poses_stale, s.tx.poses_replaced, s.tx.refused, s.tx.abandoned,
      s.reception.errors(), s.bus.bus_off, s.bus.reopened, s.reset_counter, s.bus_load_percent, s.synchronised,
      s.round_trip_ms, ms(s.latency.p50_ms), ms(s.latency.p99_ms),
      known ? std::to_string(s.latency.viso_delay_ms) : "null", own(s.own_p50_ms), own(s.own_p99_ms),
      own(s.own_max_ms));
}

}  // namespace godwit::app
