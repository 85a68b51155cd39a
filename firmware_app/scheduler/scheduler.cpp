#include "firmware_app/scheduler/scheduler.h"

#include <algorithm>
#include <cmath>

namespace godwit::app {

const char* rung_name(Rung rung) {
  constexpr const char* kNames[kRungs] = {"full", "small_input", "long_period", "few_features", "detector_off"};
  return kNames[static_cast<std::size_t>(rung)];
}

const char* rung_reason_name(RungReason reason) {
  constexpr const char* kNames[kRungReasons] = {"slips", "slow_tracker", "temperature", "throttled", "calm"};
  return kNames[static_cast<std::size_t>(reason)];
}

bool Scheduler::useful(Rung rung) const {
  if (rung == Rung::kSmallInput) return options_.detector && options_.small_input_px < options_.input_px;
  return options_.detector || rung == Rung::kFull || rung == Rung::kFewFeatures;
}

RungChange Scheduler::change(rt::TimeNs now_ns, Rung to, RungReason reason, double value, double limit) {
  const RungChange out{now_ns, rung_, to, reason, value, limit};
  ++counters_.by_reason[static_cast<std::size_t>(reason)];
  rung_ = to;
  // What was measured on the old rung says nothing of the new one.
  cost_count_ = 0;
  p95_ns_ = 0;
  slip_count_ = 0;
  t_changed_ns_ = now_ns;
  t_calm_since_ns_ = -1;
  return out;
}

std::optional<RungChange> Scheduler::down(rt::TimeNs now_ns, RungReason reason, double value, double limit) {
  const auto to = next_down();
  if (!to) return std::nullopt;
  ++counters_.steps_down;
  // A rung that did not hold: the next try comes later, so that the ladder does not swing.
  const bool relapse = t_climbed_ns_ >= 0 && now_ns - t_climbed_ns_ < calm_needed_ns_;
  calm_needed_ns_ = relapse ? std::min(2 * calm_needed_ns_, kLongestCalm * options_.calm_ns) : options_.calm_ns;
  t_climbed_ns_ = -1;
  return change(now_ns, *to, reason, value, limit);
}

std::optional<Rung> Scheduler::next_down() const {
  for (int to = static_cast<int>(rung_) + 1; to < static_cast<int>(kRungs); ++to) {
    if (useful(static_cast<Rung>(to))) return static_cast<Rung>(to);
  }
  return std::nullopt;
}

bool Scheduler::slipped_often(rt::TimeNs now_ns, int count) const {
  if (slip_count_ < count) return false;
  const std::size_t oldest = (slip_count_ - count) % kSlipsToGoBlind;
  return now_ns - slips_[oldest] < kSlipWindowNs;
}

std::optional<RungChange> Scheduler::up(rt::TimeNs now_ns) {
  int to = static_cast<int>(rung_) - 1;
  while (to >= 0 && !useful(static_cast<Rung>(to))) --to;
  if (to < 0) return std::nullopt;
  ++counters_.steps_up;
  t_climbed_ns_ = now_ns;
  const double calm_s = rt::to_seconds(calm_needed_ns_);
  return change(now_ns, static_cast<Rung>(to), RungReason::kCalm, calm_s, calm_s);
}

void Scheduler::measure(rt::TimeNs tracker_ns) {
  costs_[cost_count_ % kWindow] = tracker_ns;
  ++cost_count_;
  if (cost_count_ < kEnough) return;
  const std::size_t n = std::min(cost_count_, kWindow);
  std::array<rt::TimeNs, kWindow> sorted = costs_;
  const auto place = sorted.begin() + static_cast<std::ptrdiff_t>(n * 95 / 100);
  std::nth_element(sorted.begin(), place, sorted.begin() + static_cast<std::ptrdiff_t>(n));
  p95_ns_ = *place;
}

std::optional<RungChange> Scheduler::frame_done(rt::TimeNs now_ns, rt::TimeNs tracker_ns, rt::TimeNs late_ns,
                                                int dropped) {
  ++counters_.frames;
  if (t_last_ns_ >= 0) counters_.time_on_rung_ns[static_cast<std::size_t>(rung_)] += now_ns - t_last_ns_;
  t_last_ns_ = now_ns;
  if (tracker_ns >= 0) {
    measure(tracker_ns);
    t_tracked_ns_ = now_ns;
  } else if (now_ns - t_tracked_ns_ > kSlipWindowNs) {
    // What tracking cost before the pose was lost says nothing of now.
    cost_count_ = 0;
    p95_ns_ = 0;
  }
  const bool late = late_ns > options_.deadline_ns;
  counters_.slips += late ? 1 : 0;
  counters_.dropped += static_cast<std::uint64_t>(dropped);
  if (late || dropped > 0) slips_[slip_count_++ % kSlipsToGoBlind] = now_ns;
  if (ordered_ && !stuck_ && now_ns - t_ordered_ns_ > options_.detector_stuck_ns) {
    stuck_ = true;
    ++counters_.detector_stuck;
  }

  const bool settled = now_ns - t_changed_ns_ >= kSettleNs || (counters_.steps_down == 0 && counters_.steps_up == 0);
  const bool hot = temperature_c_ > options_.temperature_c;  // not-a-number is not hot
  // What is shed is weighed: without the detector the map goes among movers. A tracker that is slow and in time is no
  // reason for that, poses that are late are.
  const bool blind = next_down() == Rung::kDetectorOff;
  const int slip_limit = blind ? kSlipsToGoBlind : kSlipsToStep;
  if (settled) {
    if (slipped_often(now_ns, slip_limit)) return down(now_ns, RungReason::kSlips, slip_limit, slip_limit);
    if (!blind && p95_ns_ > options_.tracker_p95_ns) {
      return down(now_ns, RungReason::kSlowTracker, rt::to_ms(p95_ns_), rt::to_ms(options_.tracker_p95_ns));
    }
    if (hot) return down(now_ns, RungReason::kTemperature, temperature_c_, options_.temperature_c);
    if (throttled_) return down(now_ns, RungReason::kThrottled, 1, 0);
  }
  // Too few tracked frames to tell (p95 is 0) are no reason to wait: while nothing is tracked, masks are what helps.
  // The window of costs holds four seconds; a single slip in the time until then is none either.
  const bool restless = slipped_often(now_ns, 2);
  const bool calm = !restless && !throttled_ && !(temperature_c_ > options_.temperature_c - kCalmDegrees) &&
                    static_cast<double>(p95_ns_) < kCalmShare * static_cast<double>(options_.tracker_p95_ns);
  if (!calm) {
    t_calm_since_ns_ = -1;
    return std::nullopt;
  }
  if (t_calm_since_ns_ < 0) t_calm_since_ns_ = now_ns;
  if (now_ns - t_calm_since_ns_ >= calm_needed_ns_) return up(now_ns);
  return std::nullopt;
}

void Scheduler::machine(double temperature_c, bool throttled) {
  temperature_c_ = temperature_c;
  throttled_ = throttled;
}

rt::TimeNs Scheduler::expected_ns(int input_px) const {
  return static_cast<rt::TimeNs>(cost_per_px2_ * input_px * input_px);
}

rt::TimeNs Scheduler::period_for(int input_px) const {
  const bool longer = rung_ >= Rung::kLongPeriod;
  double frames = longer ? options_.long_period_frames : options_.period_frames;
  // Between calm and the limit of the tracker's p95 the detector steps back by up to half before a rung is lost.
  const double limit = static_cast<double>(options_.tracker_p95_ns);
  const double above_calm = (static_cast<double>(p95_ns_) / limit - kCalmShare) / (1 - kCalmShare);
  frames *= 1 + std::clamp(above_calm, 0.0, 1.0);
  return detection_period_ns(static_cast<rt::TimeNs>(frames * static_cast<double>(options_.frame_ns)),
                             expected_ns(input_px));
}

SchedulePlan Scheduler::plan() const {
  SchedulePlan out;
  out.rung = rung_;
  out.feature_share = rung_ >= Rung::kFewFeatures ? options_.few_features : 1.0;
  out.detector_on = options_.detector && rung_ < Rung::kDetectorOff && !stuck_;
  out.input_px = rung_ < Rung::kSmallInput && large_ ? options_.input_px : options_.small_input_px;
  out.period_ns = period_for(out.input_px);
  return out;
}

std::optional<DetectorOrder> Scheduler::order(rt::TimeNs now_ns, bool keyframe) {
  const SchedulePlan p = plan();
  if (!p.detector_on || ordered_) return std::nullopt;
  // A frame that comes a little early must not cost a whole one.
  const rt::TimeNs early = options_.frame_ns / 4;
  const rt::TimeNs shortest = rung_ >= Rung::kLongPeriod ? options_.period_frames * options_.frame_ns : 0;
  const rt::TimeNs wanted = keyframe ? detection_period_ns(shortest, expected_ns(p.input_px)) : p.period_ns;
  if (t_ordered_ns_ >= 0 && now_ns - t_ordered_ns_ < wanted - early) return std::nullopt;
  ordered_ = true;
  t_ordered_ns_ = now_ns;
  ordered_px_ = p.input_px;
  return DetectorOrder{ordered_px_};
}

void Scheduler::detection_done(rt::TimeNs now_ns, rt::TimeNs t_capture_ns, bool failed) {
  if (!ordered_) return;
  const bool hung = stuck_;
  ordered_ = false;
  stuck_ = false;
  ++counters_.detections;
  if (failed) ++counters_.detections_failed;
  if (now_ns - t_ordered_ns_ > options_.mask_age_ns) ++counters_.detections_late;
  const double took = static_cast<double>(now_ns - t_ordered_ns_) / (static_cast<double>(ordered_px_) * ordered_px_);
  // One that hung says nothing of what the next will cost; a second in a row does.
  if (!hung || hung_before_) cost_per_px2_ = cost_per_px2_ > 0 ? 0.8 * cost_per_px2_ + 0.2 * took : took;
  hung_before_ = hung;
  if (!failed) t_mask_ns_ = std::max(t_mask_ns_, t_capture_ns);
  const rt::TimeNs oldest = oldest_mask_ns(period_for(options_.input_px), expected_ns(options_.input_px));
  const double slack = large_ ? 1.0 : 0.8;  // back to the large input only with room to spare
  large_ = static_cast<double>(oldest) <= slack * static_cast<double>(options_.mask_age_ns);
}

}  // namespace godwit::app
