#include "firmware_app/output/live_track.h"

#include <fmt/format.h>
#include <iterator>

namespace godwit::app {

void LiveTrack::frame(const FrameRecord& r) noexcept {
  if (r.fate != FrameFate::kProcessed || !r.has_pose) return;
  for (const double x : r.t_world_cam)
    if (!std::isfinite(x)) return;
  const std::lock_guard<std::mutex> lock(mutex_);
  const std::uint32_t number = r.metric ? r.frame_id : r.map_id;
  if (r.metric != metric_ || number != number_) {
    places_.clear();
    metric_ = r.metric;
    number_ = number;
    every_ = 1;
    seen_ = 0;
  }
  for (std::size_t i = 0; i < newest_.size(); ++i) newest_[i] = static_cast<float>(r.t_world_cam[i]);
  any_ = true;
  if (seen_++ % every_ != 0) return;
  if (places_.size() == kPlaces) {
    for (std::size_t i = 0; 2 * i < kPlaces; ++i) places_[i] = places_[2 * i];
    places_.resize(kPlaces / 2);
    every_ *= 2;
  }
  places_.push_back(newest_);
}

void LiveTrack::add_line(rt::TimeNs now_ns, std::string* out) {
  if (now_ns < t_next_ns_) return;
  t_next_ns_ = now_ns + rt::kNsPerSecond;
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto to = std::back_inserter(*out);
  fmt::format_to(to, R"({{"track":{{"metric":{},"number":{},"places":[)", metric_, number_);
  for (const auto& p : places_) fmt::format_to(to, "[{:.6g},{:.6g},{:.6g}],", p[0], p[1], p[2]);
  if (any_) {
    fmt::format_to(to, "[{:.6g},{:.6g},{:.6g}]", newest_[0], newest_[1], newest_[2]);
  }
  *out += "]}}\n";
}

}  // namespace godwit::app
