// A driver's stamps on CLOCK_MONOTONIC, where they may turn out to be those of another clock. Pure; one thread.
#pragma once

#include "hal/rt/time.h"

namespace godwit::hal {

/// IIO's own stamps can be had in CLOCK_MONOTONIC, but some drivers pass on their device's: an Intel D435i's (HID) are
/// microseconds since it was plugged in, of 32 bits, which begin anew every 71.6 minutes. One stamp that cannot be is
/// left out; where they go on evenly in a clock of their own, that clock is followed: a stamp is no younger than its
/// arrival, so that its offset is the least delay from one to the other, second by second. No allocation.
class OwnClock {
 public:
  enum class Verdict : std::uint8_t {
    kGood,
    kStrange,  ///< of the future or of long ago: not to be used
    kFollowed  ///< the same; but from the next one on that clock is followed: worth telling
  };

  /// Clocks that are the same differ by less.
  static constexpr rt::TimeNs kFutureNs = 5 * rt::kNsPerMs;
  /// A driver's buffer does not hold longer than this.
  static constexpr rt::TimeNs kOldNs = rt::kNsPerSecond;
  /// So many strange ones in a row are a clock (0.1 s of a sensor at 200 Hz), if they are off by the same within
  /// kSameNs, whatever a busy machine adds to their delays, and go on at least half as fast as ours.
  static constexpr int kEnough = 20;
  static constexpr rt::TimeNs kSameNs = rt::kNsPerSecond / 2;
  static constexpr rt::TimeNs kWindowNs = rt::kNsPerSecond;
  /// Quartzes drift apart by less in kWindowNs; what the least delay rises by beyond is load.
  static constexpr rt::TimeNs kSlewNs = rt::kNsPerMs;

  /// The device was opened anew. If it was not unplugged, its clock is the one that was followed.
  void resume() {
    strange_ = 0;
    window_end_ns_ = 0;
  }
  /// stamp_ns came at arrival_ns. kGood: *t_ns is its time on CLOCK_MONOTONIC.
  Verdict take(rt::TimeNs stamp_ns, rt::TimeNs arrival_ns, rt::TimeNs* t_ns);
  /// What is added to stamps now; 0 while they are CLOCK_MONOTONIC's.
  rt::TimeNs offset_ns() const { return offset_ns_; }

 private:
  bool follows_ = false;
  rt::TimeNs offset_ns_ = 0;
  int strange_ = 0;
  rt::TimeNs strange_least_ns_ = 0, strange_stamp_ns_ = 0, strange_arrival_ns_ = 0;  ///< the last two: of the first
  rt::TimeNs window_end_ns_ = 0, window_least_ns_ = 0;  ///< of delays in the running second
};

}  // namespace godwit::hal
