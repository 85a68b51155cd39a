#include "firmware_app/output/run_writer.h"

#include <algorithm>
#include <filesystem>
#include <fmt/format.h>
#include <iterator>
#include <system_error>

#include "firmware_app/output/summary_json.h"

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
  h += ",median_depth,vx,vy,vz,v00,v01,v02,v11,v12,v22,scale_sigma";
  for (const char* what : {"gyro_bias", "accel_bias", "mounting"}) {
    for (const char axis : {'x', 'y', 'z'}) h += fmt::format(",{}_{}", what, axis);
  }
  return h +
         ",time_offset,frame_id,trust,earth_heading,earth_heading_sigma,earth_x,earth_y,earth_z,earth_place_sigma\n";
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
  const std::pair<hal::AtomicFile*, const char*> files[] = {
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
    inertial_ = r.inertial;
    if (r.metric) earth_ = r.earth;
    maps_ = std::max(maps_, r.map_id);
    ms_.push_back(ms);
    thread_cpu_ms_.push_back(thread_cpu_ms);
    proc_cpu_ms_.push_back(proc_cpu_ms);
    if (with_age_) age_ms_.push_back(rt::to_ms(r.t_done_ns - r.t_capture_ns));
  }
  count(r, &counters_);
  if (!processed && bad_reasons_.size() < kReasonsKept && std::ranges::count(bad_reasons_, r.reason.view()) == 0)
    bad_reasons_.emplace_back(r.reason.view());

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
    if (r.metric) {
      append(r.velocity);
      append(r.velocity_covariance);
      append(std::array{r.inertial.log_scale_sigma});
      append(r.inertial.gyro_bias);
      append(r.inertial.accel_bias);
      append(r.inertial.mounting);
      fmt::format_to(std::back_inserter(line_), ",{},{},{}", r.inertial.time_offset_s, r.frame_id, r.trust);
    } else {
      line_.append(22, ',');
    }
    if (r.metric && r.earth.known) {
      append(std::array{r.earth.heading, r.earth.heading_sigma});
      append(r.earth.origin_m);
      append(std::array{r.earth.place_sigma_m});
    } else {
      line_.append(6, ',');
    }
    line_ += "\n";
    written = poses_.write(line_);
  }
  return written;
}

void RunWriter::event(const rt::LogEntry& e) {
  clock_.heard(e.t_ns);
  if (++events_seen_ > kEventsKept) return;
  events_.push_back(e);
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
  s.aided_log_sigma = inertial_.aided_log_sigma;
  s.aid_share = inertial_.aid_share;
  s.earth = earth_;
  if (counters_.due > 1 && last_t_ns_ > first_t_ns_) {
    // n pictures span n - 1 intervals.
    s.pictures_hz = static_cast<double>(counters_.due - 1) / rt::to_seconds(last_t_ns_ - first_t_ns_);
    s.poses_hz = s.pictures_hz * s.tracked_share;
  }
  return s;
}

rt::Result<void> RunWriter::finish(const RunDescription& d) {
  auto written = summary_.write(
      summary_json(d, summary(), pipeline_, {events_, events_seen_ - events_.size(), clock_.first_ns(), with_age_}));
  // All to the disk before the first gets its name: a disk that fills up at the second would leave one file of a failed
  // run behind.
  for (hal::AtomicFile* file : {&trajectory_, &frames_, &poses_, &summary_}) {
    if (written.ok()) written = file->flush();
  }
  for (hal::AtomicFile* file : {&trajectory_, &frames_, &poses_, &summary_}) {
    if (written.ok()) written = file->commit();
  }
  return written;
}

}  // namespace godwit::app
