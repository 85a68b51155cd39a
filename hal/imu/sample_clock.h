// When a sensor with a clock of its own took its samples, seen only from when they were found in its buffer.
#pragma once

#include <cstdint>

#include "hal/rt/time.h"

namespace godwit::hal {

/// Samples come in even steps of a length that is known to a few per cent. Whoever looks into the buffer often learns
/// of each newest sample that it was taken between two looks; the steps' length and phase follow from that. Pure; no
/// allocation. One thread.
class SampleClock {
 public:
  /// The sensor's nominal step. Forgets everything.
  void start(rt::TimeNs step_ns);
  /// `count` samples (1 or more) were found; the newest was taken after after_ns (a look that did not find it) and not
  /// after before_ns (the look that did). Returns the time of the oldest of them; the next ones follow by step_ns().
  /// Two samples are never nearer to each other than half a step: whoever integrates divides by it.
  rt::TimeNs take(int count, rt::TimeNs after_ns, rt::TimeNs before_ns);
  /// As it is estimated now.
  rt::TimeNs step_ns() const { return static_cast<rt::TimeNs>(step_ns_); }
  /// When the next sample is to be expected; 0: unknown.
  rt::TimeNs next_ns() const { return any_ ? newest_ns_ + static_cast<rt::TimeNs>(step_ns_) : 0; }

 private:
  /// An oscillator without a crystal is off by that much at most (MPU-6000: 1 % at room temperature, 2 % over all).
  static constexpr double kMostOff = 0.03;
  bool any_ = false;
  double nominal_ns_ = 0, step_ns_ = 0;
  rt::TimeNs newest_ns_ = 0;
};

}  // namespace godwit::hal
