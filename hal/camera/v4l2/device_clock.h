// A device's timestamps on our clock: which clock it stamps in, how far off that is, and how it drifts.
#pragma once

#include <cstdint>

#include "hal/camera/v4l2/video_system.h"
#include "hal/rt/time.h"

namespace godwit::hal {

/// Decides at the first stamp whether the device stamps in CLOCK_MONOTONIC (as it says), in a clock whose offset is
/// known (Tegra's counter, BOOTTIME, REALTIME), or in one of its own, whose offset is measured: a stamp cannot be
/// younger than its arrival, so the offset follows the least delay from stamp to arrival, second by second. Pure; no
/// allocation. One thread.
class DeviceClock {
 public:
  enum class Source : std::uint8_t { kUnknown, kMonotonic, kCounter, kBoottime, kRealtime, kMeasured, kArrival };
  enum class Verdict : std::uint8_t {
    kGood,
    kRepeats,   ///< the stamp before once more: the picture is not to be flown
    kWentBack,  ///< earlier than the one before, on the same clock: not to be flown
    kJumped     ///< the clock was set anew: from the next stamp on it is followed again; not to be flown
  };
  struct Reading {
    Verdict verdict = Verdict::kGood;
    rt::TimeNs t_ns = 0;          ///< the stamp on CLOCK_MONOTONIC
    rt::TimeNs off_ns = 0;        ///< kJumped: by how much
    bool source_changed = false;  ///< source() is another than before: worth telling
  };

  /// A stamp that arrives later than this was not taken in the clock that it would be read in.
  static constexpr rt::TimeNs kMostDelayNs = rt::kNsPerSecond;
  /// Clocks that are the same and read one after the other differ by less.
  static constexpr rt::TimeNs kSlackNs = 2 * rt::kNsPerMs;
  /// A quartz drifts by at most 100 ppm and the kernel slews by at most 500: 0.6 ms a second. What the least delay of
  /// a second moves beyond is not followed at once: it is load.
  static constexpr rt::TimeNs kSlewNs = rt::kNsPerMs;
  /// A delay that grows by more from one picture to the next was not spent in a queue.
  static constexpr rt::TimeNs kStepNs = rt::kNsPerSecond;
  static constexpr rt::TimeNs kWindowNs = rt::kNsPerSecond;
  /// So many stamps in a row that repeat: the device's clock stands, and arrivals are all there is.
  static constexpr int kStandsStill = 3;

  /// offsets: as the machine has them now. least_delay_ns: what lies between a stamp and its arrival even when nothing
  /// is late (exposure and readout behind a stamp of the start).
  void start(const ClockOffsets& offsets, rt::TimeNs least_delay_ns);
  /// A buffer stamped stamp_ns was taken from the driver at arrival_ns.
  Reading take(rt::TimeNs stamp_ns, rt::TimeNs arrival_ns);

  Source source() const { return source_; }
  /// What is added to stamps now.
  rt::TimeNs offset_ns() const { return offset_ns_; }
  /// Static text.
  static const char* name(Source source);

 private:
  void decide(rt::TimeNs delay_ns);
  void follow(rt::TimeNs delay_ns, rt::TimeNs arrival_ns);

  ClockOffsets offsets_;
  rt::TimeNs least_delay_ns_ = 0;
  Source source_ = Source::kUnknown;
  rt::TimeNs offset_ns_ = 0;
  bool any_ = false;
  rt::TimeNs last_stamp_ns_ = 0, last_delay_ns_ = 0;
  int repeats_ = 0;
  rt::TimeNs window_end_ns_ = 0, window_least_ns_ = 0;  ///< least delay of the running second
  bool window_any_ = false;
  rt::TimeNs first_least_ns_ = 0;  ///< known offset: least delay of the first second, which a drift moves
  bool first_known_ = false;
};

}  // namespace godwit::hal
