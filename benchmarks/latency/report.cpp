#include "benchmarks/latency/report.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <sys/utsname.h>
#include <thread>

#include "firmware_app/config/version.h"

namespace godwit::bench {
namespace {

using Json = nlohmann::ordered_json;

Json of(const Distribution& d) {
  return {{"samples", d.samples}, {"median", d.p50}, {"p95", d.p95},  {"p99", d.p99},
          {"p99_9", d.p999},      {"max", d.max},    {"mean", d.mean}};
}

Json of(const FlightFigures& f) {
  Json stages = Json::object();
  for (std::size_t i = 0; i < app::kStages; ++i) stages[app::kStageNames[i]] = of(f.stages[i]);
  Json threads = Json::array();
  for (const ThreadUse& t : f.threads) {
    Json thread = {
        {"name", t.name}, {"cpu_percent", t.cpu_percent}, {"waits", t.waits}, {"preemptions", t.preemptions}};
    if (t.minor_faults >= 0) thread["minor_page_faults"] = t.minor_faults;
    if (t.major_faults >= 0) thread["major_page_faults"] = t.major_faults;
    if (t.allocations >= 0) thread["heap_operations"] = t.allocations;
    threads.push_back(std::move(thread));
  }
  Json out = {
      {"detector", f.detector},
      {"seconds", f.seconds},
      {"frames",
       {{"due", f.due}, {"processed", f.processed}, {"tracked", f.tracked}, {"bad", f.bad}, {"dropped", f.dropped}}},
      {"first_pose_frames", f.first_pose_frames},
      {"first_pose_ms", f.first_pose_ms},
      {"poses_hz", f.poses_hz},
      {"deadline_ms", f.deadline_ms},
      {"missed_deadlines", f.missed_deadlines},
      {"delivery_ms", of(f.delivery)},
      {"age_at_pose_ms", of(f.age_at_pose)},
      {"own_at_pose_ms", of(f.own_at_pose)}};
  out["age_at_bus_ms"] = f.age_at_bus.samples > 0 ? of(f.age_at_bus) : Json(nullptr);
  out["own_at_bus_ms"] = f.own_at_bus.samples > 0 ? of(f.own_at_bus) : Json(nullptr);
  out["tracker_cpu_ms"] = of(f.tracker_cpu);
  out["detection_cpu_ms"] = {{"full", of(f.detection_cpu[0])}, {"small", of(f.detection_cpu[1])}};
  out["stages_ms"] = std::move(stages);
  out["detections"] = {{"done", f.detections}, {"failed", f.detections_failed}, {"late", f.detections_late}};
  out["rung"] = f.rung;
  out["threads"] = std::move(threads);
  out["memory_mb"] = {
      {"resident", f.resident_mb}, {"peak", f.peak_mb}, {"locked", f.locked_mb}, {"pictures", f.pictures_mb}};
  out["refused"] = f.refused;
  return out;
}

void add_row(std::string* out, const char* name, const Distribution& d) {
  if (d.samples == 0) {
    *out += fmt::format("  {:<26} {:>8}\n", name, "-");
    return;
  }
  *out += fmt::format("  {:<26} {:8.2f} {:8.2f} {:8.2f} {:8.2f} {:8.2f}\n", name, d.p50, d.p95, d.p99, d.p999, d.max);
}

void add_flight(std::string* out, const FlightFigures& f) {
  *out += fmt::format(
      "\ndetector {}: {} frames in {:.1f} s, {} tracked ({:.2f} poses a second), {} dropped, {} bad, "
      "{} later than {:.1f} ms after delivery\n",
      f.detector ? "on" : "off", f.due, f.seconds, f.tracked, f.poses_hz, f.dropped, f.bad, f.missed_deadlines,
      f.deadline_ms);
  if (f.first_pose_frames >= 0) {
    *out += fmt::format("first pose after {} frames, {:.0f} ms\n", f.first_pose_frames, f.first_pose_ms);
  } else {
    *out += "no pose was found\n";
  }
  if (f.detector) {
    *out += fmt::format("{} detections, {} failed, {} late; ladder at its end: {}\n", f.detections, f.detections_failed,
                        f.detections_late, f.rung);
  }
  *out += fmt::format("  {:<26} {:>8} {:>8} {:>8} {:>8} {:>8}\n", "[ms]", "p50", "p95", "p99", "p99.9", "max");
  add_row(out, "picture delivered after", f.delivery);
  add_row(out, "age at pose", f.age_at_pose);
  add_row(out, "  our own share", f.own_at_pose);
  add_row(out, f.age_at_bus.samples > 0 ? "age at bus" : "age at bus (no --can)", f.age_at_bus);
  if (f.age_at_bus.samples > 0) add_row(out, "  our own share", f.own_at_bus);
  add_row(out, "tracker, thread CPU time", f.tracker_cpu);
  if (f.detector) {
    add_row(out, "a detection, CPU time", f.detection_cpu[0]);
    if (f.detection_cpu[1].samples > 0) add_row(out, "  of small input", f.detection_cpu[1]);
  }
  for (std::size_t i = 0; i < app::kStages; ++i) {
    add_row(out, (std::string("  stage ") + app::kStageNames[i]).c_str(), f.stages[i]);
  }
  *out += fmt::format("  {:<16} {:>7} {:>9} {:>9} {:>12} {:>9}\n", "thread", "CPU %", "waits", "preempted",
                      "page faults", "heap");
  for (const ThreadUse& t : f.threads) {
    const std::string faults = t.minor_faults < 0 ? "-" : fmt::format("{} + {}", t.minor_faults, t.major_faults);
    *out += fmt::format("  {:<16} {:7.1f} {:9} {:9} {:>12} {:>9}\n", t.name, t.cpu_percent, t.waits, t.preemptions,
                        faults, t.allocations < 0 ? "-" : std::to_string(t.allocations));
  }
  *out += fmt::format(
      "memory: {:.0f} MB resident ({:.0f} MB of them the pictures of the simulated camera), {:.0f} MB "
      "locked, {:.0f} MB at the highest\n",
      f.resident_mb, f.pictures_mb, f.locked_mb, f.peak_mb);
  if (!f.refused.empty()) *out += "warning: " + f.refused + "\n";
}

}  // namespace

std::string table(const Run& run) {
  std::string out = fmt::format("{} at {:.3g} pictures a second; configuration: {}\n", run.input, run.fps,
                                run.config_file.empty() ? "defaults" : run.config_file);
  if (run.live) {
    out += "live camera: our own share counts from the picture in our memory, as measured\n";
  } else {
    out += fmt::format(
        "simulated camera: exposure {:.3g} ms, readout {:.3g} ms, transfer {:.3g} ms: a picture is {:.3g} ms "
        "old when it comes\n",
        run.delays.exposure_ms, run.delays.readout_ms, run.delays.transfer_ms, run.delays.delivery_ms());
  }
  for (const FlightFigures& f : run.flights) add_flight(&out, f);
  return out;
}

std::string json(const Run& run) {
  utsname machine{};
  uname(&machine);
  Json flights = Json::array();
  for (const FlightFigures& f : run.flights) flights.push_back(of(f));
  const Json delays = {{"exposure", run.delays.exposure_ms},
                       {"readout", run.delays.readout_ms},
                       {"transfer", run.delays.transfer_ms},
                       {"delivery", run.delays.delivery_ms()}};
  const Json out = {{"kind", "latency"},
                    {"schema", 1},
                    {"version", app::version_words(app::version())},
                    {"machine",
                     {{"architecture", machine.machine},
                      {"kernel", machine.release},
                      {"processors", std::thread::hardware_concurrency()}}},
                    {"input", run.input},
                    {"config", run.config_file},
                    {"fps", run.fps},
                    {"camera_delays_ms", run.live ? Json(nullptr) : delays},
                    {"flights", std::move(flights)}};
  // A name with broken UTF-8 must not make the file unreadable.
  return out.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace godwit::bench
