#include "hal/camera/device/device_clock.h"

#include <algorithm>
#include <cstdlib>

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

bool DeviceClock::known() const {
  return source_ == Source::kCounter || source_ == Source::kBoottime || source_ == Source::kRealtime;
}

rt::TimeNs DeviceClock::known_offset(const ClockOffsets& offsets) const {
  switch (source_) {
    case Source::kCounter:
      // A file that can no longer be read leaves the offset as it was.
      return offsets.counter_ns ? counter_sign_ * *offsets.counter_ns : offset_ns_;
    case Source::kBoottime:
      return offsets.boottime_ns;
    case Source::kRealtime:
      return offsets.realtime_ns;
    default:
      return offset_ns_;
  }
}

void DeviceClock::decide(rt::TimeNs delay_ns, const ClockOffsets& offsets, rt::TimeNs least_delay_ns) {
  const auto fits = [&](rt::TimeNs offset) {
    return delay_ns - offset >= -kSlackNs && delay_ns - offset <= kMostDelayNs;
  };
  window_any_ = false;
  settling_ = true;
  old_since_ns_ = 0;
  pending_ = {};
  exposure_seen_ns_ = least_delay_ns;
  exposure_moved_ = exposure_moved_before_ = false;
  const auto choose = [&](Source source, rt::TimeNs offset) {
    source_ = source;
    offset_ns_ = offset;
  };
  if (fits(0)) return choose(Source::kMonotonic, 0);
  if (offsets.counter_ns) {
    // Releases differ in which of the two is the later one; a wrong sign would miss by far more than a delay.
    for (const int sign : {-1, 1}) {
      counter_sign_ = sign;
      if (fits(sign * *offsets.counter_ns)) return choose(Source::kCounter, sign * *offsets.counter_ns);
    }
  }
  if (fits(offsets.boottime_ns)) return choose(Source::kBoottime, offsets.boottime_ns);
  if (fits(offsets.realtime_ns)) return choose(Source::kRealtime, offsets.realtime_ns);
  choose(Source::kMeasured, delay_ns - least_delay_ns);
}

bool DeviceClock::look_whether_late(rt::TimeNs delay_ns, rt::TimeNs arrival_ns) {
  const rt::TimeNs late = delay_ns - offset_ns_;
  if (!window_any_) {
    window_any_ = true;
    window_end_ns_ = arrival_ns + kWindowNs;
    window_least_ns_ = late;
    return false;
  }
  window_least_ns_ = std::min(window_least_ns_, late);
  if (arrival_ns < window_end_ns_) return false;
  window_any_ = false;
  const bool tell = window_least_ns_ > kLateNs && !told_late_;
  told_late_ = window_least_ns_ > kLateNs;
  return tell;
}

void DeviceClock::close_window() {
  settling_ = false;
  window_any_ = false;
  if (pending_.good && !exposure_moved_) {
    // Downwards at once: arrivals that were late made it too large. Upwards as fast as clocks drift.
    offset_ns_ += std::min(pending_.least_ns - offset_ns_, kSlewNs);
  }
  pending_ = {!exposure_moved_ && !exposure_moved_before_, window_least_ns_};
  exposure_moved_before_ = exposure_moved_;
  exposure_moved_ = false;
}

void DeviceClock::measure(rt::TimeNs delay_ns, rt::TimeNs arrival_ns, rt::TimeNs least_delay_ns) {
  // What lies between the stamp and a prompt arrival is exposure and readout; what the rest moves by is the clock's. An
  // exposure that has changed is known sooner or later than the first picture that has it, so a second next to such a
  // change says nothing.
  if (std::abs(least_delay_ns - exposure_seen_ns_) > kSameExposureNs) {
    exposure_moved_ = true;
    exposure_seen_ns_ = least_delay_ns;
  }
  const rt::TimeNs seen = delay_ns - least_delay_ns;
  // Arrived before it happened, or sooner than any in the first second.
  offset_ns_ = std::min(offset_ns_, settling_ && !exposure_moved_ ? seen : delay_ns);
  if (!window_any_) {
    window_any_ = true;
    window_end_ns_ = arrival_ns + kWindowNs;
    window_least_ns_ = seen;
    return;
  }
  window_least_ns_ = std::min(window_least_ns_, seen);
  if (arrival_ns >= window_end_ns_) close_window();
}

bool DeviceClock::was_set_back(rt::TimeNs delay_ns, bool leapt, bool back, rt::TimeNs arrival_ns) {
  if (delay_ns - offset_ns_ <= kMostDelayNs) {
    old_since_ns_ = 0;
    return false;
  }
  if (leapt && back) return true;
  if (leapt && old_since_ns_ == 0) old_since_ns_ = arrival_ns;
  return old_since_ns_ != 0 && arrival_ns - old_since_ns_ > kWindowNs;
}

DeviceClock::Reading DeviceClock::take(rt::TimeNs stamp_ns, rt::TimeNs arrival_ns, const ClockOffsets& offsets,
                                       rt::TimeNs least_delay_ns) {
  const Source before = source_;
  Reading out;
  if (any_ && stamp_ns == last_stamp_ns_) {
    if (++repeats_ < kStandsStill) {
      out.verdict = Verdict::kRepeats;
      return out;
    }
    source_ = Source::kArrival;
    out.t_ns = arrival_ns - least_delay_ns;
    out.source_changed = before != source_;
    return out;
  }
  const bool back = any_ && stamp_ns < last_stamp_ns_;
  const rt::TimeNs delay = arrival_ns - stamp_ns;
  // A measured offset may rest on late arrivals: earlier ones only correct it.
  const rt::TimeNs early = source_ == Source::kMeasured ? kMostDelayNs : kSlackNs + kSlewNs;
  const rt::TimeNs last_delay = last_delay_ns_;
  repeats_ = 0;
  last_stamp_ns_ = stamp_ns;
  last_delay_ns_ = delay;
  const rt::TimeNs moved = known_offset(offsets) - offset_ns_;
  if (!any_ || source_ == Source::kArrival) {
    any_ = true;
    decide(delay, offsets, least_delay_ns);
  } else if (known() && std::abs(moved) > kSlackNs) {
    // Somebody set that clock between two pictures; whether this one was stamped before or after, nobody knows.
    offset_ns_ += moved;
    window_any_ = false;
    out.verdict = Verdict::kJumped;
    out.off_ns = moved;
    return out;
  } else if (offset_ns_ += moved; delay - offset_ns_ < -early ||
                                  was_set_back(delay, delay - last_delay > kStepNs, back, arrival_ns) ||
                                  (back && source_ == Source::kMeasured)) {
    out.verdict = Verdict::kJumped;
    out.off_ns = offset_ns_ - delay;
    decide(delay, offsets, least_delay_ns);
    out.source_changed = before != source_;
    return out;
  } else if (back) {
    out.verdict = Verdict::kWentBack;
    return out;
  }
  if (source_ == Source::kMeasured) {
    measure(delay, arrival_ns, least_delay_ns);
  } else if (known() && look_whether_late(delay, arrival_ns)) {
    out.late = true;
    out.off_ns = window_least_ns_;
  }
  out.t_ns = stamp_ns + offset_ns_;
  out.source_changed = before != source_;
  return out;
}

}  // namespace godwit::hal
