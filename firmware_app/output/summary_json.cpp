#include "firmware_app/output/summary_json.h"

#include <cmath>
#include <nlohmann/json.hpp>

namespace godwit::app {
namespace {

using Json = nlohmann::ordered_json;

/// Digits beyond what is measured are noise to a reader.
double rounded(double value, int digits) {
  const double scale = std::pow(10, digits);
  return std::round(value * scale) / scale;
}
double fine(double value) {
  return rounded(value, 4);
}
double to_thousandths(double value) {
  return rounded(value, 3);
}

Json of(const Statistics& s) {
  return {{"median", fine(s.median)},
          {"p95", fine(s.p95)},
          {"p99", fine(s.p99)},
          {"max", fine(s.max)},
          {"mean", fine(s.mean)}};
}

Json of(const rt::LogEntry& e, rt::TimeNs first_t_ns) {
  return {{"t", to_thousandths(rt::to_seconds(e.t_ns - first_t_ns))},
          {"what", e.what},
          {"before", e.before},
          {"which", e.which},
          {"why", e.why},
          {"value", fine(e.value)},
          {"limit", fine(e.limit)}};
}

/// What was late, dropped and shed, and why.
Json scheduler_of(const PipelineCounters& p) {
  const SchedulerCounters& c = p.scheduler;
  Json reasons = Json::object(), seconds = Json::object();
  for (std::size_t i = 0; i < kRungReasons; ++i) reasons[rung_reason_name(static_cast<RungReason>(i))] = c.by_reason[i];
  for (std::size_t i = 0; i < kRungs; ++i) {
    seconds[rung_name(static_cast<Rung>(i))] = to_thousandths(rt::to_seconds(c.time_on_rung_ns[i]));
  }
  return {{"late", c.slips},
          {"dropped", c.dropped},
          {"rungs_down", c.steps_down},
          {"rungs_up", c.steps_up},
          {"reasons", std::move(reasons)},
          {"seconds_on_rung", std::move(seconds)},
          {"rung", rung_name(p.rung)},
          {"detections", c.detections},
          {"detections_failed", c.detections_failed},
          {"detections_late", c.detections_late},
          {"detector_stuck", c.detector_stuck},
          {"keyframes_undetected", c.keyframes_undetected}};
}

Json of(const ImuCounters& c) {
  return {{"samples", c.samples},         {"saturated", c.saturated}, {"gaps", c.gaps},        {"faults", c.faults},
          {"implausible", c.implausible}, {"dropped", c.dropped},     {"silences", c.silences}};
}

Json of(const EarthRecord& e) {
  Json j = {
      {"north", north_word(e)}, {"fixes", e.fixes}, {"fixes_used", e.fixes_used}, {"fixes_refused", e.fixes_refused}};
  if (!e.known) return j;
  j["heading_deg"] = fine(e.heading * 180 / M_PI);
  j["heading_sigma_deg"] = fine(e.heading_sigma * 180 / M_PI);
  j["origin_m"] = e.origin_m;
  j["place_sigma_m"] = fine(e.place_sigma_m);
  return j;
}

Json of(const ThreadReport& t) {
  return {{"name", t.name},
          {"minor_faults", t.faults.minor},
          {"major_faults", t.faults.major},
          {"stack_kb", t.stack_used / 1024}};
}

}  // namespace

std::string summary_json(const RunDescription& d, const RunSummary& s, const PipelineCounters& pipeline,
                         const RunTold& told) {
  const bool found = s.first_pose_frames >= 0;
  Json j;
  j["version"] = d.version;
  j["sequence"] = d.sequence;
  j["mode"] = d.mode;
  j["pace"] = d.pace;
  j["start"] = d.start;
  j["frames"] = s.counters.due;
  j["processed"] = s.counters.processed;
  j["repeated_pictures"] = s.counters.repeated;
  j["bad_pictures"] = s.counters.bad;
  j["dropped_no_slot"] = s.counters.dropped_slots;
  j["dropped_late"] = s.counters.dropped_late;
  j["tracked"] = s.tracked;
  j["tracked_share"] = rounded(s.tracked_share, 6);
  j["tracked_share_after_first_pose"] = found ? Json(rounded(s.tracked_share_after_first, 6)) : Json();
  j["maps"] = s.maps;
  j["first_pose_after_frames"] = found ? Json(s.first_pose_frames) : Json();
  j["first_pose_after_ms"] = found ? Json(to_thousandths(s.first_pose_ms)) : Json();
  j["ms"] = of(s.ms);
  j["thread_cpu_ms"] = of(s.thread_cpu_ms);
  j["proc_cpu_ms"] = of(s.proc_cpu_ms);
  j["pictures_hz"] = to_thousandths(s.pictures_hz);
  j["poses_hz"] = to_thousandths(s.poses_hz);
  if (!d.link.empty()) j["link"] = Json::parse(d.link);
  if (told.with_age) {
    j["age_ms"] = of(s.age_ms);
    j["scheduler"] = scheduler_of(pipeline);
  }
  j["events"] = Json::array();
  for (const rt::LogEntry& e : told.events) j["events"].push_back(of(e, told.first_t_ns));
  j["events_not_kept"] = told.events_not_kept + pipeline.events_lost;
  if (pipeline.imu) j["imu"] = of(*pipeline.imu);
  if (s.aided_log_sigma > 0) {
    j["aids"] = {{"scale_sigma", fine(s.aided_log_sigma)}};
    constexpr std::array<const char*, vo::kScaleSources> kNames = {"range", "baro", "gnss", "starting_height"};
    for (std::size_t i = 0; i < s.aid_share.size(); ++i) j["aids"][kNames[i]] = fine(s.aid_share[i]);
  }
  if (s.earth.fixes > 0) j["earth"] = of(s.earth);
  j["records_lost"] = pipeline.records_lost;
  j["threads"] = Json::array();
  for (const ThreadReport& t : pipeline.threads) j["threads"].push_back(of(t));
  j["peak_memory_mb"] = rounded(peak_memory_mb(), 1);
  return j.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace godwit::app
