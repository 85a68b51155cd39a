#include <cmath>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

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
  lines.push_back(fmt::format("{} ODOMETRY sent, {} passed over for a newer one, {} stale{}", s.odometry_sent,
                              s.poses_paced, s.poses_stale,
                              s.has_bus ? fmt::format("; bus load {:.1f} %", s.bus_load_percent) : ""));
  if (s.poses_carried > 0) {
    lines.push_back(fmt::format("{} of them between pictures, by the inertial sensor{}", s.poses_carried,
                                s.readings_missed > 0 ? fmt::format("; {} readings missed", s.readings_missed) : ""));
  }
  if (s.pictures_repeated > 0) {
    lines.push_back(
        fmt::format("{} pictures were the one before, bit for bit: nothing was sent for them", s.pictures_repeated));
  }
  const std::uint64_t lost = s.tx.poses_replaced + s.tx.refused + s.tx.abandoned;
  if (lost + s.bus.bus_off + s.bus.reopened + s.reception.errors() > 0) {
    lines.push_back(
        fmt::format("sending: {} messages dropped whole, {} of them poses", lost, s.tx.poses_replaced) +
        (s.has_bus
             ? fmt::format("; bus-off {} times, opened again {} times; {} frames of others could not be put together",
                           s.bus.bus_off, s.bus.reopened, s.reception.errors())
             : ""));
  }
  return lines;
}

std::string link_report_json(const link::LinkStatus& s) {
  using Json = nlohmann::ordered_json;
  const auto ms = [](bool known, double value) { return known ? Json(std::round(value * 1e3) / 1e3) : Json(); };
  const bool known = s.latency.samples >= link::LatencyMonitor::kMinSamples, own = s.own_samples > 0;
  const Json j = {{"node_id", s.node_id},
                  {"odometry_sent", s.odometry_sent},
                  {"poses_paced", s.poses_paced},
                  {"poses_stale", s.poses_stale},
                  {"poses_carried", s.poses_carried},
                  {"readings_missed", s.readings_missed},
                  {"pictures_repeated", s.pictures_repeated},
                  {"poses_replaced", s.tx.poses_replaced},
                  {"messages_refused", s.tx.refused},
                  {"messages_abandoned", s.tx.abandoned},
                  {"reception_errors", s.reception.errors()},
                  {"bus_off", s.bus.bus_off},
                  {"reopened", s.bus.reopened},
                  {"reset_counter", s.reset_counter},
                  {"bus_load_percent", std::round(s.bus_load_percent * 1e2) / 1e2},
                  {"timesync", s.synchronised},
                  {"round_trip_ms", ms(true, s.round_trip_ms)},
                  {"latency_p50_ms", ms(known, s.latency.p50_ms)},
                  {"latency_p99_ms", ms(known, s.latency.p99_ms)},
                  {"viso_delay_ms", known ? Json(s.latency.viso_delay_ms) : Json()},
                  {"own_p50_ms", ms(own, s.own_p50_ms)},
                  {"own_p99_ms", ms(own, s.own_p99_ms)},
                  {"own_max_ms", ms(own, s.own_max_ms)}};
  return j.dump();
}

}  // namespace godwit::app
