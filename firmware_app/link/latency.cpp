#include "firmware_app/link/latency.h"

#include <algorithm>
#include <cmath>

namespace godwit::link {
namespace {
constexpr double kGrowthMs = 10;
constexpr double kGrowthShare = 1.25;
constexpr int kMaxDelayMs = 250;  // ArduPilot's limit of VISO_DELAY_MS
}  // namespace

mavlink::Timesync TimeSync::question(rt::TimeNs now_ns) {
  asked_[next_question_] = now_ns;
  next_question_ = (next_question_ + 1) % asked_.size();
  mavlink::Timesync message;
  message.ts1 = now_ns;
  return message;
}

mavlink::Timesync TimeSync::answer(const mavlink::Timesync& question, rt::TimeNs now_ns) {
  mavlink::Timesync message;
  message.tc1 = now_ns;
  message.ts1 = question.ts1;
  return message;
}

bool TimeSync::take_answer(const mavlink::Timesync& answer, rt::TimeNs now_ns) {
  if (answer.tc1 <= 0 || answer.ts1 <= 0 || answer.ts1 > now_ns || now_ns - answer.ts1 > rt::kNsPerSecond) return false;
  const auto asked = std::find(asked_.begin(), asked_.end(), answer.ts1);
  if (asked == asked_.end()) return false;
  *asked = 0;  // a repeated answer says nothing new
  Answer& slot = window_[answers_ % kWindow];
  slot.round_trip_ns = now_ns - answer.ts1;
  slot.offset_ns = answer.tc1 - (answer.ts1 + slot.round_trip_ns / 2);
  ++answers_;
  last_answer_ns_ = now_ns;
  const auto end = window_.begin() + static_cast<std::ptrdiff_t>(std::min<std::uint64_t>(answers_, kWindow));
  const auto best = std::min_element(
      window_.begin(), end, [](const Answer& a, const Answer& b) { return a.round_trip_ns < b.round_trip_ns; });
  best_round_trip_ns_ = best->round_trip_ns;
  offset_ns_ = best->offset_ns;
  return true;
}

bool TimeSync::synchronised(rt::TimeNs now_ns) const {
  return answers_ >= 8 && now_ns - last_answer_ns_ <= 10 * rt::kNsPerSecond;
}

void TimeWindow::add(rt::TimeNs time_ns) {
  times_ms_[count_ % kSize] = static_cast<float>(rt::to_ms(time_ns));
  ++count_;
}

void TimeWindow::sort() {
  sorted_ = size();
  const auto end = sorted_ms_.begin() + static_cast<std::ptrdiff_t>(sorted_);
  std::copy_n(times_ms_.begin(), sorted_, sorted_ms_.begin());
  std::sort(sorted_ms_.begin(), end);
}

double TimeWindow::share_ms(double share) const {
  if (sorted_ == 0) return 0;
  return static_cast<double>(sorted_ms_[static_cast<std::size_t>(share * static_cast<double>(sorted_ - 1))]);
}

void LatencyMonitor::add(rt::TimeNs t_capture_ns, rt::TimeNs t_sent_ns, const LatencyPath& path) {
  const rt::TimeNs total = t_sent_ns - t_capture_ns + path.one_way_ns + path.wire_extra_ns;
  total_.add(total);
  corrected_.add(total - path.serial_correction_ns);
}

LatencySummary LatencyMonitor::summary() {
  LatencySummary out;
  out.samples = total_.size();
  if (out.samples == 0) return out;
  total_.sort();
  corrected_.sort();
  out.min_ms = total_.share_ms(0);
  out.p50_ms = total_.share_ms(0.5);
  out.p99_ms = total_.share_ms(0.99);
  out.viso_delay_ms = std::clamp(static_cast<int>(std::lround(corrected_.share_ms(0))), 0, kMaxDelayMs);
  if (out.samples >= kMinSamples && baseline_p50_ms_ <= 0) baseline_p50_ms_ = out.p50_ms;
  out.grew =
      baseline_p50_ms_ > 0 && out.p50_ms > baseline_p50_ms_ + kGrowthMs && out.p50_ms > baseline_p50_ms_ * kGrowthShare;
  return out;
}

}  // namespace godwit::link
