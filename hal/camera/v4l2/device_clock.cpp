#include "hal/camera/v4l2/device_clock.h"

#include <algorithm>

namespace godwit::hal {

const char* DeviceClock::name(Source source) {
  switch (source) {
    case Source::kUnknown:
      return "unknown";
    case Source::kMonotonic:
      return "CLOCK_MONOTONIC";
    case Source::kCounter:
      return "the counter of clocksource0/offset_ns";
    case Source::kBoottime:
      return "CLOCK_BOOTTIME";
    case Source::kRealtime:
      return "CLOCK_REALTIME";
    case Source::kMeasured:
      return "a clock of its own, measured by arrivals";
    case Source::kArrival:
      return "none that goes: arrivals are used";
  }
  return "unknown";
}

void DeviceClock::start(const ClockOffsets& offsets, rt::TimeNs least_delay_ns) {
  *this = {};
  offsets_ = offsets;
  least_delay_ns_ = least_delay_ns;
}

void DeviceClock::decide(rt::TimeNs delay_ns) {
  const auto fits = [&](rt::TimeNs offset) {
    return delay_ns - offset >= -kSlackNs && delay_ns - offset <= kMostDelayNs;
  };
  window_any_ = false;
  first_known_ = false;
  const auto choose = [&](Source source, rt::TimeNs offset) {
    source_ = source;
    offset_ns_ = offset;
  };
  if (fits(0)) return choose(Source::kMonotonic, 0);
  if (offsets_.counter_ns) {
    // Releases differ in which of the two is the later one; a wrong sign would miss by far more than a delay.
    for (const rt::TimeNs offset : {-*offsets_.counter_ns, *offsets_.counter_ns}) {
      if (fits(offset)) return choose(Source::kCounter, offset);
    }
  }
  if (fits(offsets_.boottime_ns)) return choose(Source::kBoottime, offsets_.boottime_ns);
  if (fits(offsets_.realtime_ns)) return choose(Source::kRealtime, offsets_.realtime_ns);
  choose(Source::kMeasured, delay_ns - least_delay_ns_);
}

void DeviceClock::follow(rt::TimeNs delay_ns, rt::TimeNs arrival_ns) {
  if (source_ == Source::kMonotonic) return;
  // Arrived before it happened: the offset was measured on late arrivals.
  if (source_ == Source::kMeasured) offset_ns_ = std::min(offset_ns_, delay_ns - least_delay_ns_);
  if (!window_any_) {
    window_any_ = true;
    window_end_ns_ = arrival_ns + kWindowNs;
    window_least_ns_ = delay_ns;
    return;
  }
  window_least_ns_ = std::min(window_least_ns_, delay_ns);
  if (arrival_ns < window_end_ns_) return;
  // What lies between the stamp and a prompt arrival does not change; what the least delay moves by is the clock's.
  const rt::TimeNs behind = source_ == Source::kMeasured ? least_delay_ns_ : first_least_ns_;
  if (source_ == Source::kMeasured || first_known_) {
    offset_ns_ += std::clamp(window_least_ns_ - behind - offset_ns_, -kSlewNs, kSlewNs);
  } else {
    first_known_ = true;
    first_least_ns_ = window_least_ns_ - offset_ns_;
  }
  window_any_ = false;
}

DeviceClock::Reading DeviceClock::take(rt::TimeNs stamp_ns, rt::TimeNs arrival_ns) {
  const Source before = source_;
  Reading out;
  if (any_ && stamp_ns == last_stamp_ns_) {
    if (++repeats_ < kStandsStill) {
      out.verdict = Verdict::kRepeats;
      return out;
    }
    source_ = Source::kArrival;
    out.t_ns = arrival_ns - least_delay_ns_;
    out.source_changed = before != source_;
    return out;
  }
  const bool back = any_ && stamp_ns < last_stamp_ns_;
  const rt::TimeNs delay = arrival_ns - stamp_ns;
  // A measured offset may rest on late arrivals: earlier ones only correct it.
  const rt::TimeNs early = source_ == Source::kMeasured ? kMostDelayNs : kSlackNs + kSlewNs;
  // A picture that waited for a busy machine grows old from one to the next, a clock that is set leaps.
  const rt::TimeNs last_delay = last_delay_ns_;
  repeats_ = 0;
  last_stamp_ns_ = stamp_ns;
  last_delay_ns_ = delay;
  if (!any_ || source_ == Source::kArrival) {
    any_ = true;
    decide(delay);
  } else if (delay - offset_ns_ < -early || (delay - offset_ns_ > kMostDelayNs && delay - last_delay > kStepNs) ||
             (back && source_ == Source::kMeasured)) {
    out.verdict = Verdict::kJumped;
    out.off_ns = offset_ns_ - delay;
    decide(delay);
    out.source_changed = before != source_;
    return out;
  } else if (back) {
    out.verdict = Verdict::kWentBack;
    return out;
  }
  follow(delay, arrival_ns);
  out.t_ns = stamp_ns + offset_ns_;
  out.source_changed = before != source_;
  return out;
}

}  // namespace godwit::hal
