#include "firmware_app/output/run_writer.h"

#include <algorithm>
#include <filesystem>
#include <fmt/format.h>
#include <iterator>
#include <system_error>

namespace godwit::app {
namespace {

namespace fs = std::filesystem;

/// Seconds with 9 decimals, exact.
void append_time(rt::TimeNs t_ns, std::string* out) {
  fmt::format_to(std::back_inserter(*out), "{}.{:09}", t_ns / rt::kNsPerSecond, t_ns % rt::kNsPerSecond);
}

void append_pose(const FrameRecord& r, char separator, std::string* out) {
  for (const double v : r.t_world_cam) fmt::format_to(std::back_inserter(*out), "{}{}", separator, v);
  for (const double v : r.q_world_cam) fmt::format_to(std::back_inserter(*out), "{}{}", separator, v);
}

/// A CSV field in quotes where it needs them (RFC 4180).
std::string csv_field(std::string_view text) {
  if (text.find_first_of(",\"\n\r") == std::string_view::npos) return std::string(text);
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"') out += '"';
    out += (c == '\n' || c == '\r') ? ' ' : c;
  }
  return out + '"';
}

/// Length of the UTF-8 sequence that text begins with; 0: it is none (RFC 3629).
std::size_t utf8_length(std::string_view text) {
  const auto byte = [&](std::size_t i) { return i < text.size() ? static_cast<unsigned char>(text[i]) : 0U; };
  const unsigned lead = byte(0);
  if (lead < 0x80) return 1;
  const std::size_t length = lead >= 0xF0 && lead < 0xF5   ? 4
                             : lead >= 0xE0 && lead < 0xF0 ? 3
                             : lead >= 0xC2 && lead < 0xE0 ? 2
                                                           : 0;
  for (std::size_t i = 1; i < length; ++i) {
    if ((byte(i) & 0xC0U) != 0x80) return 0;
  }
  // Overlong forms, surrogates, and beyond the last character.
  const bool wrong = (lead == 0xE0 && byte(1) < 0xA0) || (lead == 0xED && byte(1) > 0x9F) ||
                     (lead == 0xF0 && byte(1) < 0x90) || (lead == 0xF4 && byte(1) > 0x8F);
  return wrong ? 0 : length;
}

std::string json_string(std::string_view text) {
  std::string out = "\"";
  while (!text.empty()) {
    const std::size_t length = utf8_length(text);
    const char c = text.front();
    if (length != 1) {
      // What is no text (a file's name may be anything) is shown as such.
      out += length == 0 ? std::string_view("\\ufffd") : text.substr(0, length);
      text.remove_prefix(std::max<std::size_t>(1, length));
      continue;
    }
    text.remove_prefix(1);
    if (c == '"' || c == '\\') out += '\\';
    if (static_cast<unsigned char>(c) < 0x20) {
      out += fmt::format("\\u{:04x}", static_cast<unsigned>(c));
    } else {
      out += c;
    }
  }
  return out + '"';
}

std::string json_statistics(const Statistics& s) {
  return fmt::format(R"({{"median": {:.4f}, "p95": {:.4f}, "p99": {:.4f}, "max": {:.4f}, "mean": {:.4f}}})", s.median,
                     s.p95, s.p99, s.max, s.mean);
}

std::string json_list(const std::vector<std::string>& items) {
  std::string out = "[";
  for (const std::string& item : items) out += (out.size() > 1 ? ",\n    " : "\n    ") + item;
  return out + (items.empty() ? "]" : "\n  ]");
}

/// What was late, dropped and shed, and why.
std::string json_scheduler(const PipelineCounters& p) {
  const SchedulerCounters& c = p.scheduler;
  std::string reasons, seconds;
  for (std::size_t i = 0; i < kRungReasons; ++i) {
    reasons +=
        fmt::format(R"({}"{}": {})", i > 0 ? ", " : "", rung_reason_name(static_cast<RungReason>(i)), c.by_reason[i]);
  }
  for (std::size_t i = 0; i < kRungs; ++i) {
    seconds += fmt::format(R"({}"{}": {:.3f})", i > 0 ? ", " : "", rung_name(static_cast<Rung>(i)),
                           rt::to_seconds(c.time_on_rung_ns[i]));
  }
  return fmt::format(
      R"({{"late": {}, "dropped": {}, "rungs_down": {}, "rungs_up": {}, "reasons": {{{}}}, "seconds_on_rung": {{{}}}, )"
      R"("rung": "{}", "detections": {}, "detections_failed": {}, "detections_late": {}, "detector_stuck": {}, )"
      R"("keyframes_undetected": {}}})",
      c.slips, c.dropped, c.steps_down, c.steps_up, reasons, seconds, rung_name(p.rung), c.detections,
      c.detections_failed, c.detections_late, c.detector_stuck, c.keyframes_undetected);
}

std::string frames_header() {
  std::string h = "t,ms,thread_cpu_ms,proc_cpu_ms,tracked,map_id,state,features,fate,keyframe,map_moved,age_ms";
  for (const char* stage : kStageNames) h += std::string(",") + stage + "_ms";
  return h +
         ",keyframe_reason,map_messages,map_seeds,map_seeds_updated,map_points_new,map_keyframes,map_points,"
         "ba_runs,ba_free,ba_fixed,ba_points,ba_observations,ba_iterations,ba_outliers,ba_rms_before_px,"
         "ba_rms_after_px,reason\n";
}

void append_triangle(char name, std::string* out) {
  for (int row = 0; row < 6; ++row) {
    for (int column = row; column < 6; ++column) *out += fmt::format(",{}{}{}", name, row, column);
  }
}

std::string poses_header() {
  std::string h = "t,state,tracked,map_id,tx,ty,tz,qx,qy,qz,qw";
  append_triangle('c', &h);
  h += ",ref_id,ref_t,rtx,rty,rtz,rqx,rqy,rqz,rqw";
  append_triangle('r', &h);
  return h + ",median_depth\n";
}

/// What the mapper did before this frame was done; nothing where it did nothing.
void append_mapping(const MappingRecord& m, std::string* out) {
  if (m.messages == 0) {
    *out += ",,,,,,";
  } else {
    fmt::format_to(std::back_inserter(*out), ",{},{},{},{},{},{}", m.messages, m.seeds, m.seeds_updated, m.points_new,
                   m.keyframes, m.points);
  }
  if (m.adjustments == 0) {
    *out += ",,,,,,,,,";
  } else {
    fmt::format_to(std::back_inserter(*out), ",{},{},{},{},{},{},{},{:.4f},{:.4f}", m.adjustments, m.free_keyframes,
                   m.fixed_keyframes, m.adjusted_points, m.observations, m.iterations, m.outliers, m.rms_before_px,
                   m.rms_after_px);
  }
}

}  // namespace

rt::Result<void> RunWriter::open(const std::string& folder, bool with_age) {
  with_age_ = with_age;
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) return rt::Error{folder + ": cannot be created: " + error.message()};
  const fs::path root(folder);
  const std::pair<AtomicFile*, const char*> files[] = {
      {&trajectory_, "trajectory.tum"}, {&frames_, "frames.csv"}, {&poses_, "pose.csv"}, {&summary_, "summary.json"}};
  for (const auto& [file, name] : files) {
    auto opened = file->open(root / name);
    if (!opened) return opened;
  }
  // Results of an earlier run must not pass for this one's if it fails half-way.
  for (const auto& [file, name] : files) {
    fs::remove(root / name, error);
    if (error) return rt::Error{(root / name).string() + ": cannot be removed: " + error.message()};
  }
  auto written = trajectory_.write("# t tx ty tz qx qy qz qw map_id (camera to world)\n");
  if (written.ok()) written = frames_.write(frames_header());
  if (written.ok()) written = poses_.write(poses_header());
  return written;
}

rt::Result<void> RunWriter::take(const FrameRecord& r) {
  const bool processed = r.fate == FrameFate::kProcessed;
  if (processed) state_ = r.state;
  if (first_t_ns_ < 0) first_t_ns_ = r.t_source_ns;
  clock_.heard(r.t_capture_ns);
  last_t_ns_ = std::max(last_t_ns_, r.t_source_ns);
  const double ms = rt::to_ms(r.wall_ns);
  const double thread_cpu_ms = rt::to_ms(r.thread_cpu_ns);
  const double proc_cpu_ms = rt::to_ms(r.thread_cpu_ns + r.mapper_cpu_ns);
  if (r.tracked) {
    if (first_pose_frames_ < 0) {
      first_pose_frames_ = static_cast<std::int64_t>(counters_.due);
      first_pose_t_ns_ = r.t_source_ns;
    }
    ++tracked_;
    maps_ = std::max(maps_, r.map_id);
    ms_.push_back(ms);
    thread_cpu_ms_.push_back(thread_cpu_ms);
    proc_cpu_ms_.push_back(proc_cpu_ms);
    if (with_age_) age_ms_.push_back(rt::to_ms(r.t_done_ns - r.t_capture_ns));
  }
  count(r, &counters_);
  if (!processed && bad_reasons_.size() < kReasonsKept) bad_reasons_.emplace_back(r.reason.view());

  line_.clear();
  append_time(r.t_source_ns, &line_);
  fmt::format_to(std::back_inserter(line_), ",{:.4f},{:.4f},{:.4f},{},", ms, thread_cpu_ms, proc_cpu_ms,
                 r.tracked ? 1 : 0);
  if (r.tracked) fmt::format_to(std::back_inserter(line_), "{}", r.map_id);
  fmt::format_to(std::back_inserter(line_), ",{},{},{},{},{},", vo::state_name(state_), r.features, fate_name(r.fate),
                 r.is_keyframe ? 1 : 0, r.map_moved ? 1 : 0);
  if (processed && with_age_) {
    fmt::format_to(std::back_inserter(line_), "{:.4f}", rt::to_ms(r.t_done_ns - r.t_capture_ns));
  }
  for (const rt::TimeNs ns : r.stage_ns) fmt::format_to(std::back_inserter(line_), ",{:.4f}", rt::to_ms(ns));
  line_ += ",";
  line_ += r.keyframe_reason;
  append_mapping(r.mapping, &line_);
  line_ += ",";
  line_ += csv_field(r.reason.view());
  line_ += "\n";
  auto written = frames_.write(line_);

  if (written.ok() && r.tracked) {
    line_.clear();
    append_time(r.t_source_ns, &line_);
    append_pose(r, ' ', &line_);
    fmt::format_to(std::back_inserter(line_), " {}\n", r.map_id);
    written = trajectory_.write(line_);
  }
  if (written.ok() && r.has_pose) {
    line_.clear();
    append_time(r.t_source_ns, &line_);
    fmt::format_to(std::back_inserter(line_), ",{},{},{}", vo::state_name(r.state), r.tracked ? 1 : 0, r.map_id);
    append_pose(r, ',', &line_);
    const auto append = [this](const auto& values) {
      for (const double v : values) fmt::format_to(std::back_inserter(line_), ",{}", v);
    };
    append(r.covariance);
    fmt::format_to(std::back_inserter(line_), ",{},", r.reference_id);
    if (r.reference_id != 0) {
      // In the sequence's own time; a source's clock and that of the captures differ by a constant.
      append_time(r.t_source_ns - (r.t_capture_ns - r.t_reference_ns), &line_);
      append(r.t_ref_cam);
      append(r.q_ref_cam);
      append(r.reference_covariance);
    } else {
      line_.append(28, ',');
    }
    fmt::format_to(std::back_inserter(line_), ",{}", r.median_depth);
    line_ += "\n";
    written = poses_.write(line_);
  }
  return written;
}

void RunWriter::event(const rt::LogEntry& e) {
  clock_.heard(e.t_ns);
  if (++events_seen_ > kEventsKept) return;
  events_.push_back(fmt::format(
      R"({{"t": {:.3f}, "what": {}, "before": {}, "which": {}, "why": {}, "value": {:.6g}, "limit": {:.6g}}})",
      rt::to_seconds(e.t_ns - clock_.first_ns()), json_string(e.what), json_string(e.before), json_string(e.which),
      json_string(e.why), e.value, e.limit));
}

RunSummary RunWriter::summary() const {
  RunSummary s;
  s.counters = counters_;
  s.tracked = tracked_;
  s.maps = maps_;
  s.first_pose_frames = first_pose_frames_;
  if (counters_.due > 0) s.tracked_share = static_cast<double>(tracked_) / static_cast<double>(counters_.due);
  if (first_pose_frames_ >= 0) {
    const double rest = static_cast<double>(counters_.due) - static_cast<double>(first_pose_frames_);
    s.tracked_share_after_first = static_cast<double>(tracked_) / rest;
    s.first_pose_ms = rt::to_ms(first_pose_t_ns_ - first_t_ns_);
  }
  s.ms = statistics_of(ms_);
  s.thread_cpu_ms = statistics_of(thread_cpu_ms_);
  s.proc_cpu_ms = statistics_of(proc_cpu_ms_);
  s.age_ms = statistics_of(age_ms_);
  if (counters_.due > 1 && last_t_ns_ > first_t_ns_) {
    // n pictures span n - 1 intervals.
    s.pictures_hz = static_cast<double>(counters_.due - 1) / rt::to_seconds(last_t_ns_ - first_t_ns_);
    s.poses_hz = s.pictures_hz * s.tracked_share;
  }
  return s;
}

rt::Result<void> RunWriter::finish(const RunDescription& d) {
  const RunSummary s = summary();
  const bool found = s.first_pose_frames >= 0;
  const std::string null = "null";
  std::string j = "{\n";
  const auto line = [&](const char* key, const std::string& value) { j += fmt::format("  \"{}\": {},\n", key, value); };
  line("version", json_string(d.version));
  line("sequence", json_string(d.sequence));
  line("mode", json_string(d.mode));
  line("pace", json_string(d.pace));
  line("start", std::to_string(d.start));
  line("frames", std::to_string(s.counters.due));
  line("processed", std::to_string(s.counters.processed));
  line("bad_pictures", std::to_string(s.counters.bad));
  line("dropped_no_slot", std::to_string(s.counters.dropped_slots));
  line("dropped_late", std::to_string(s.counters.dropped_late));
  line("tracked", std::to_string(s.tracked));
  line("tracked_share", fmt::format("{:.6f}", s.tracked_share));
  line("tracked_share_after_first_pose", found ? fmt::format("{:.6f}", s.tracked_share_after_first) : null);
  line("maps", std::to_string(s.maps));
  line("first_pose_after_frames", found ? std::to_string(s.first_pose_frames) : null);
  line("first_pose_after_ms", found ? fmt::format("{:.3f}", s.first_pose_ms) : null);
  line("ms", json_statistics(s.ms));
  line("thread_cpu_ms", json_statistics(s.thread_cpu_ms));
  line("proc_cpu_ms", json_statistics(s.proc_cpu_ms));
  line("pictures_hz", fmt::format("{:.3f}", s.pictures_hz));
  line("poses_hz", fmt::format("{:.3f}", s.poses_hz));
  if (!d.link.empty()) line("link", d.link);
  if (with_age_) {
    line("age_ms", json_statistics(s.age_ms));
    line("scheduler", json_scheduler(pipeline_));
  }
  line("events", json_list(events_));
  line("events_not_kept", std::to_string(events_seen_ - events_.size() + pipeline_.events_lost));
  if (const auto& imu = pipeline_.imu) {
    line("imu",
         fmt::format(R"({{"samples": {}, "gaps": {}, "faults": {}, "implausible": {}, "dropped": {}, "silences": {}}})",
                     imu->samples, imu->gaps, imu->faults, imu->implausible, imu->dropped, imu->silences));
  }
  line("records_lost", std::to_string(pipeline_.records_lost));
  std::vector<std::string> threads;
  for (const ThreadReport& t : pipeline_.threads) {
    threads.push_back(fmt::format(R"({{"name": {}, "minor_faults": {}, "major_faults": {}, "stack_kb": {}}})",
                                  json_string(t.name), t.faults.minor, t.faults.major, t.stack_used / 1024));
  }
  line("threads", json_list(threads));
  j += fmt::format("  \"peak_memory_mb\": {:.1f}\n}}\n", peak_memory_mb());
  auto written = summary_.write(j);
  // All to the disk before the first gets its name: a disk that fills up at the second would leave one file of a failed
  // run behind.
  for (AtomicFile* file : {&trajectory_, &frames_, &poses_, &summary_}) {
    if (written.ok()) written = file->flush();
  }
  for (AtomicFile* file : {&trajectory_, &frames_, &poses_, &summary_}) {
    if (written.ok()) written = file->commit();
  }
  return written;
}

}  // namespace godwit::app
