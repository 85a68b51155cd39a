#include "firmware_app/output/flown_log.h"

#include <algorithm>
#include <filesystem>
#include <optional>

#include "firmware_app/output/flight_log.h"
#include "firmware_app/output/ulog_reader.h"

namespace godwit::app {
namespace {

namespace fs = std::filesystem;

/// What one file holds.
struct FilePart {
  std::vector<FlownFrame> frames;
  std::map<rt::TimeNs, FoundBoxes> detections;
  std::map<rt::TimeNs, std::int32_t> boxes_due;
  std::optional<std::uint64_t> end;  ///< number of the flight's last frame
  std::uint64_t dropped = 0;         ///< messages, as the log itself counted them last
  std::string broken;                ///< where it breaks off; empty: it does not
  bool known = true;                 ///< the fields are those that we write
};

class PartReader {
 public:
  explicit PartReader(FilePart* part) : part_(part) {}

  void take(const ulog::ReadSample& s) {
    if (s.topic() == "pose") {
      known(s.get("sequence", &pose_.sequence) && s.get("position", &pose_.t_world_cam) &&
            s.get("q_xyzw", &pose_.q_world_cam));
      have_pose_ = true;
    } else if (s.topic() == "order") {
      take_order(s);
    } else if (s.topic() == "detection") {
      FoundBoxes found;
      std::int32_t count = 0;
      known(s.get("t_capture_ns", &found.t_capture_ns) && s.get("boxes", &count));
      part_->detections[found.t_capture_ns] = found;
      part_->boxes_due[found.t_capture_ns] = count;
    } else if (s.topic() == "box") {
      take_box(s);
    } else if (s.topic() == "end") {
      std::uint64_t frames = 0;
      known(s.get("frames", &frames));
      part_->end = frames;
    } else if (s.topic() == "log") {
      s.get("dropped", &part_->dropped);
    }
  }

 private:
  void known(bool all) { part_->known = part_->known && all; }

  void take_order(const ulog::ReadSample& s) {
    FlownFrame f;
    FlownOrder& o = f.order;
    known(s.get("t_capture_ns", &f.t_capture_ns) && s.get("t_source_ns", &f.t_source_ns) &&
          s.get("t_detection_ns", &o.t_detection_ns) && s.get("t_reading_ns", &o.t_reading_ns) &&
          s.get("number", &o.number) && s.get("readings", &o.readings) && s.get("feature_share", &o.feature_share) &&
          s.get("sequence", &f.sequence) && s.get("room", &o.room) && s.get("deltas", &o.deltas));
    if (have_pose_ && pose_.sequence == f.sequence) {
      f.has_pose = true;
      f.t_world_cam = pose_.t_world_cam;
      f.q_world_cam = pose_.q_world_cam;
    }
    have_pose_ = false;
    part_->frames.push_back(f);
  }

  void take_box(const ulog::ReadSample& s) {
    rt::TimeNs t_ns = 0;
    std::array<float, 4> edges{};
    detector::Box b;
    known(s.get("t_capture_ns", &t_ns) && s.get("x0_y0_x1_y1", &edges) && s.get("score", &b.score) &&
          s.get("class_id", &b.class_id));
    b.x0 = edges[0];
    b.y0 = edges[1];
    b.x1 = edges[2];
    b.y1 = edges[3];
    const auto found = part_->detections.find(t_ns);
    if (found != part_->detections.end()) found->second.boxes.push(b);
  }

  FilePart* const part_;
  FlownFrame pose_;  ///< the newest; it comes before its frame's order
  bool have_pose_ = false;
};

rt::Result<FilePart> read_part(const std::string& file) {
  FilePart part;
  PartReader reader(&part);
  auto read = ulog::read_samples(file, [&](const ulog::ReadSample& s) { reader.take(s); });
  if (!read) return read.error();
  part.broken = read.value();
  if (!part.known) return rt::Error{file + ": is a flight log of another version"};
  return part;
}

std::string missing_frame(std::uint64_t number, std::uint64_t dropped) {
  return "frame " + std::to_string(number) + " of the flight is missing" +
         (dropped > 0 ? ", and the log says that " + std::to_string(dropped) + " messages were dropped" : "");
}

/// Takes the frames over until one is missing, or what it needs.
void append(const FilePart& part, FlownLog* log) {
  log->detections.insert(part.detections.begin(), part.detections.end());
  for (const FlownFrame& f : part.frames) {
    const std::uint64_t due = log->frames.size() + 1;
    if (f.order.number != due) {
      log->gap = missing_frame(due, part.dropped);
      return;
    }
    log->frames.push_back(f);
  }
  if (!part.broken.empty()) log->gap = "the file " + part.broken;
}

/// A detection may stand behind the frame that it came in with, so that only the whole log knows.
void look_for_detections(const std::map<rt::TimeNs, std::int32_t>& boxes_due, FlownLog* log) {
  for (std::size_t i = 0; i < log->frames.size(); ++i) {
    const rt::TimeNs t_ns = log->frames[i].order.t_detection_ns;
    if (t_ns == 0) continue;
    const auto found = log->detections.find(t_ns);
    if (found != log->detections.end() && found->second.boxes.count == boxes_due.at(t_ns)) continue;
    log->gap = "the detection is missing that came in with frame " + std::to_string(i + 1);
    log->frames.resize(i);
    return;
  }
}

}  // namespace

rt::Result<FlownLog> read_flown_log(const std::string& file) {
  auto first = read_part(file);
  if (!first) return first.error();
  FilePart part = std::move(first).value();
  if (part.frames.empty()) return rt::Error{file + ": holds no frame that could be flown again"};
  if (part.frames.front().order.number != 1)
    return rt::Error{file + ": the flight begins in an earlier file; its first is asked for"};
  FlownLog log;
  std::map<rt::TimeNs, std::int32_t> boxes_due = part.boxes_due;
  append(part, &log);
  for (std::string next = next_flight_file(file); !part.end && log.gap.empty(); next = next_flight_file(next)) {
    std::error_code error;
    if (next.empty() || !fs::is_regular_file(next, error)) break;
    auto read = read_part(next);
    if (!read) break;
    // Another flight begins with its first frame.
    if (!read.value().frames.empty() && read.value().frames.front().order.number <= 1) break;
    part = std::move(read).value();
    boxes_due.insert(part.boxes_due.begin(), part.boxes_due.end());
    append(part, &log);
  }
  if (log.gap.empty() && !part.end) log.gap = "it ends without the flight's end";
  if (log.gap.empty() && *part.end != log.frames.size()) log.gap = missing_frame(log.frames.size() + 1, part.dropped);
  look_for_detections(boxes_due, &log);
  return log;
}

void keep_first(std::int64_t pictures, FlownLog* log) {
  const auto behind = [&](const FlownFrame& f) { return std::int64_t{f.sequence} >= pictures; };
  const auto begin = std::find_if(log->frames.begin(), log->frames.end(), behind);
  const bool reached =
      begin != log->frames.end() || (!log->frames.empty() && std::int64_t{log->frames.back().sequence} + 1 == pictures);
  log->frames.erase(begin, log->frames.end());
  if (reached) log->gap.clear();
}

}  // namespace godwit::app
