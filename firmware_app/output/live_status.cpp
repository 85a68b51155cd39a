#include "firmware_app/output/live_status.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <string_view>
#include <unistd.h>
#include <vector>

namespace godwit::app {
namespace {

using Json = nlohmann::ordered_json;

double rounded(double value, double step) {
  return std::round(value / step) * step;
}

/// Null for what is no number.
Json number(double value, double step) {
  return std::isfinite(value) ? Json(rounded(value, step)) : Json();
}

Json spread(std::vector<float>* values) {
  if (values->empty()) return nullptr;
  std::sort(values->begin(), values->end());
  const auto at = [&](double p) {
    return number((*values)[static_cast<std::size_t>(p * static_cast<double>(values->size() - 1))], 0.01);
  };
  return {{"p50", at(0.5)}, {"p95", at(0.95)}, {"max", at(1)}};
}

/// One sigma of the camera's place: along the axes of the camera, in the pose's units.
double place_sigma(const FrameRecord& r) {
  return std::sqrt(std::max(0.0, r.covariance[0] + r.covariance[6] + r.covariance[11]));
}

}  // namespace

void LiveStatus::frame(const FrameRecord& r) noexcept {
  const std::lock_guard<std::mutex> lock(mutex_);
  Frame& f = frames_[seen_++ % kFrames];
  f = {};
  f.t_ns = rt::monotonic_now_ns();
  f.processed = r.fate == FrameFate::kProcessed;
  if (!f.processed) {
    ++not_flown_;
    return;
  }
  f.tracked = r.tracked;
  f.age_ms = static_cast<float>(rt::to_ms(r.t_done_ns - r.t_capture_ns));
  f.own_ms = static_cast<float>(rt::to_ms(r.t_done_ns - r.t_delivered_ns));
  f.tracking_ms = static_cast<float>(rt::to_ms(r.wall_ns));
  if (r.tracked) ++tracked_;
  last_ = r;
  any_ = true;
  if (r.mapping.messages > 0) mapping_ = r.mapping;
}

void LiveStatus::event(const rt::LogEntry& e, const std::string& line) noexcept {
  try {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (std::string_view(e.what).starts_with("rung")) rung_ = e.which;
    lines_.push_back(line);
    ++line_count_;
    if (lines_.size() > kLines) lines_.pop_front();
  } catch (const std::exception&) {
  }
}

std::string LiveStatus::snapshot(rt::TimeNs now_ns) {
  if (sources_.machine != nullptr && now_ns - t_machine_ns_ >= rt::kNsPerSecond) {
    machine_ = sources_.machine->read();
    t_machine_ns_ = now_ns;
  }
  std::vector<float> age, own, tracking;
  Json j;
  j["version"] = sources_.version;
  j["pid"] = getpid();
  j["uptime_s"] = number(rt::to_seconds(now_ns - t_begin_ns_), 0.1);
  const std::lock_guard<std::mutex> lock(mutex_);
  std::uint64_t due = 0, poses = 0;
  for (std::uint64_t i = 0; i < std::min<std::uint64_t>(seen_, kFrames); ++i) {
    const Frame& f = frames_[(seen_ - 1 - i) % kFrames];
    if (now_ns - f.t_ns > kWindowNs) break;
    ++due;
    if (f.tracked) ++poses;
    if (!f.processed) continue;
    age.push_back(f.age_ms);
    own.push_back(f.own_ms);
    tracking.push_back(f.tracking_ms);
  }
  const FrameRecord& r = last_;
  const double window_s = std::min(rt::to_seconds(kWindowNs), std::max(0.1, rt::to_seconds(now_ns - t_begin_ns_)));
  j["state"] = any_ ? Json(vo::state_name(r.state)) : Json();
  j["reason"] = any_ ? Json(r.reason.view()) : Json();
  j["last_frame_s"] = any_ ? number(rt::to_seconds(now_ns - r.t_capture_ns), 0.001) : Json();
  j["quality"] = sources_.quality ? Json(sources_.quality()) : Json();
  j["metric"] = any_ && r.metric;
  j["trust"] = any_ && r.metric ? number(r.trust, 0.01) : Json();
  j["map"] = any_ ? Json(r.map_id) : Json();
  j["position"] = any_ && r.has_pose ? Json{number(r.t_world_cam[0], 1e-4), number(r.t_world_cam[1], 1e-4),
                                            number(r.t_world_cam[2], 1e-4)}
                                     : Json();
  j["position_sigma"] = any_ && r.has_pose ? number(place_sigma(r), 1e-4) : Json();
  const bool earth = any_ && r.earth.fixes > 0;
  j["north"] = earth ? Json(north_word(r.earth)) : Json();
  j["north_sigma_deg"] = earth && r.earth.known ? number(r.earth.heading_sigma * 180 / M_PI, 0.1) : Json();
  j["fixes_used"] = earth ? Json(r.earth.fixes_used) : Json();
  j["fixes_refused"] = earth ? Json(r.earth.fixes_refused) : Json();
  j["fixes"] = earth ? Json(r.earth.fixes) : Json();
  j["features"] = any_ ? Json(r.features) : Json();
  j["keyframes"] = any_ ? Json(mapping_.keyframes) : Json();
  j["points"] = any_ ? Json(mapping_.points) : Json();
  j["seeds"] = any_ ? Json(mapping_.seeds) : Json();
  j["pictures_hz"] = number(static_cast<double>(due) / window_s, 0.1);
  j["poses_hz"] = number(static_cast<double>(poses) / window_s, 0.1);
  j["frames"] = seen_;
  j["tracked"] = tracked_;
  j["not_flown"] = not_flown_;
  j["age_ms"] = spread(&age);
  j["own_ms"] = spread(&own);
  j["tracking_ms"] = spread(&tracking);
  j["rung"] = rung_;
  j["temperature_c"] = number(machine_.temperature_c, 0.1);
  j["throttled"] = machine_.throttled;
  j["events_told"] = line_count_;
  j["events"] = lines_;
  return j.dump(-1, ' ', false, Json::error_handler_t::replace);
}

}  // namespace godwit::app
