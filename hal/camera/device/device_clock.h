// A device's timestamps on our clock: which clock it stamps in, how far off that is, and how it drifts.
#pragma once

#include <cstdint>

#include "hal/camera/device/machine_clocks.h"
#include "hal/rt/time.h"

namespace godwit::hal {

/// Decides at the first stamp whether the device stamps in CLOCK_MONOTONIC (as it says), in a clock whose offset the
/// machine knows (Tegra's counter, BOOTTIME, REALTIME), or in one of its own. A known offset is taken as the machine
/// has it at each stamp and never moved by arrivals: load must not pass for drift. One of its own is measured: a stamp
/// cannot be younger than its arrival, so the offset follows the least delay from stamp to arrival, second by second.
/// Pure; no allocation. One thread.
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
    rt::TimeNs off_ns = 0;        ///< kJumped: by how much; late: the second's least delay
    bool source_changed = false;  ///< source() is another than before: worth telling
    /// For a second no picture came sooner than kLateNs after its time: a known offset that is probably wrong. Once.
    bool late = false;
  };

  /// A stamp that arrives later than this was not taken in the clock that it would be read in.
  static constexpr rt::TimeNs kMostDelayNs = rt::kNsPerSecond;
  /// Clocks that are the same and read one after the other differ by less; one that moves by more between two stamps
  /// was set.
  static constexpr rt::TimeNs kSlackNs = 2 * rt::kNsPerMs;
  /// A quartz drifts by at most 100 ppm and the kernel slews by at most 500: 0.6 ms a second. What the least delay of
  /// a second rises by beyond is not followed at once: it is load.
  static constexpr rt::TimeNs kSlewNs = rt::kNsPerMs;
  /// A delay that grows by more from one picture to the next: either nobody looked for so long, and the picture lay in
  /// the driver's queue, or the clock was set back while nothing came. The queue is empty at once; what is as old for a
  /// second (kWindowNs) shows a clock that was set. Where the stamp goes back, too, it was set.
  static constexpr rt::TimeNs kStepNs = rt::kNsPerSecond;
  static constexpr rt::TimeNs kWindowNs = rt::kNsPerSecond;
  /// Exposure, readout and a USB camera's own work take less.
  static constexpr rt::TimeNs kLateNs = 300 * rt::kNsPerMs;
  /// Exposures that differ by less are the same to the measurement of an offset.
  static constexpr rt::TimeNs kSameExposureNs = 200'000;
  /// So many stamps in a row that repeat: the device's clock stands, and arrivals are all there is.
  static constexpr int kStandsStill = 3;

  /// Forgets everything.
  void start() { *this = {}; }
  /// A buffer stamped stamp_ns was taken from the driver at arrival_ns. offsets: as the machine has them now.
  /// least_delay_ns: what lies now between a stamp and its arrival even when nothing is late (exposure and readout
  /// behind a stamp of the start).
  Reading take(rt::TimeNs stamp_ns, rt::TimeNs arrival_ns, const ClockOffsets& offsets, rt::TimeNs least_delay_ns);

  Source source() const { return source_; }
  /// What is added to stamps now.
  rt::TimeNs offset_ns() const { return offset_ns_; }
  /// Static text.
  static const char* name(Source source);

 private:
  bool known() const;
  /// Of a picture that is late. leapt: by kStepNs and more later than the one before.
  bool was_set_back(rt::TimeNs delay_ns, bool leapt, bool back, rt::TimeNs arrival_ns);
  /// The machine's word on the clock that was decided on.
  rt::TimeNs known_offset(const ClockOffsets& offsets) const;
  void decide(rt::TimeNs delay_ns, const ClockOffsets& offsets, rt::TimeNs least_delay_ns);
  void measure(rt::TimeNs delay_ns, rt::TimeNs arrival_ns, rt::TimeNs least_delay_ns);
  void close_window();
  bool look_whether_late(rt::TimeNs delay_ns, rt::TimeNs arrival_ns);

  Source source_ = Source::kUnknown;
  rt::TimeNs offset_ns_ = 0;
  int counter_sign_ = 1;
  bool any_ = false;
  rt::TimeNs last_stamp_ns_ = 0, last_delay_ns_ = 0;
  rt::TimeNs old_since_ns_ = 0;  ///< arrival of the first of those that are older than they should be; 0: none
  int repeats_ = 0;

  // The running second.
  bool window_any_ = false;
  rt::TimeNs window_end_ns_ = 0, window_least_ns_ = 0;
  bool told_late_ = false;
  // Of a clock of its own alone.
  bool settling_ = true;  ///< its first second: late first pictures are corrected at once
  rt::TimeNs exposure_seen_ns_ = 0;
  bool exposure_moved_ = false;         ///< in the running second
  bool exposure_moved_before_ = false;  ///< in the one before
  struct {
    bool good = false;
    rt::TimeNs least_ns = 0;
  } pending_;  ///< the second before: it counts if the exposure changed neither in it nor in those next to it
};

}  // namespace godwit::hal
