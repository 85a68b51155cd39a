#include "firmware_app/link/status_texts.h"

#include <algorithm>
#include <cstdio>

namespace godwit::link {
namespace {

constexpr rt::TimeNs kMinGapNs = 500 * rt::kNsPerMs;
constexpr rt::TimeNs kLatencyPeriodNs = 60 * rt::kNsPerSecond;

const char* state_words(PoseState state) {
  switch (state) {
    case PoseState::kInitialising:
      return "initialising";
    case PoseState::kTracking:
      return "tracking";
    case PoseState::kCoasting:
      return "coasting on inertial data";
    case PoseState::kRelocalising:
      return "relocalising, no pose";
    case PoseState::kLost:
      return "lost, no pose";
  }
  return "unknown";
}

}  // namespace

std::optional<StatusLine> StatusTexts::of_state(PoseState state, bool usable, bool stalled, rt::TimeNs now_ns) {
  if ((state == told_state_ && usable == told_usable_) || now_ns - t_told_ns_ < kMinGapNs) return std::nullopt;
  told_state_ = state;
  told_usable_ = usable;
  t_told_ns_ = now_ns;
  StatusLine line;
  line.severity = usable ? mavlink::StatusText::kInfo : mavlink::StatusText::kWarning;
  std::snprintf(line.text.data(), line.text.size(), "VIO: %s%s", stalled ? "no picture, no pose" : state_words(state),
                vo::claims_pose(state) && !usable ? ", no scale yet" : "");
  return line;
}

StatusLine StatusTexts::of_origin(bool sent) {
  StatusLine line;
  line.severity = sent ? mavlink::StatusText::kInfo : mavlink::StatusText::kWarning;
  std::snprintf(line.text.data(), line.text.size(), "VIO: %s", sent ? "origin sent" : "no origin is configured");
  return line;
}

std::optional<StatusLine> StatusTexts::of_latency(const LatencySummary& l, bool synchronised, rt::TimeNs now_ns) {
  const bool growth = l.grew && !told_growth_;
  const bool due = l.samples >= LatencyMonitor::kMinSamples && now_ns >= t_next_latency_ns_ && synchronised;
  if (!growth && !due) return std::nullopt;
  told_growth_ = l.grew;
  t_next_latency_ns_ = now_ns + kLatencyPeriodNs;
  StatusLine line;
  line.severity = growth ? mavlink::StatusText::kWarning : mavlink::StatusText::kInfo;
  // 50 characters at most with three digits each, so that the delay to set is never cut.
  const auto figure = [](double ms) { return static_cast<int>(std::min(ms, 999.0)); };
  std::snprintf(
      line.text.data(), line.text.size(),
      growth ? "VIO LATENCY GREW p50 %d p99 %d VISO_DELAY_MS %d" : "VIO latency p50 %d p99 %d ms, VISO_DELAY_MS %d",
      figure(l.p50_ms), figure(l.p99_ms), l.viso_delay_ms);
  return line;
}

}  // namespace godwit::link
