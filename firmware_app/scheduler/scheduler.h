// Who gets the processor: tracking first, the detector from what is left. Pure logic; time comes as an argument.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "hal/rt/time.h"

namespace godwit::app {

/// The ladder of degradation, best first. Each rung keeps what those above it gave up.
enum class Rung : std::uint8_t {
  kFull,         ///< everything
  kSmallInput,   ///< the detector looks at a smaller picture
  kLongPeriod,   ///< and less often
  kFewFeatures,  ///< the tracker measures fewer points
  kDetectorOff   ///< nothing but tracking and mapping
};
constexpr std::size_t kRungs = 5;
const char* rung_name(Rung rung);

/// Why a rung was left.
enum class RungReason : std::uint8_t {
  kSlips,        ///< too many poses came too late, or frames were dropped because the tracker was busy
  kSlowTracker,  ///< the tracker's p95 came above its share
  kTemperature,
  kThrottled,  ///< the machine slows its processors down
  kCalm        ///< upwards: everything was well for long enough
};
constexpr std::size_t kRungReasons = 5;
const char* rung_reason_name(RungReason reason);

struct SchedulerOptions {
  bool detector = false;                ///< there is one; without it the rungs that are the detector's are passed over
  rt::TimeNs deadline_ns = 33'300'000;  ///< a pose that stands later than this after its delivery is a slip
  rt::TimeNs tracker_p95_ns = 15'000'000;        ///< above: a rung down
  rt::TimeNs frame_ns = 33'333'333;              ///< interval of the camera
  double temperature_c = 85;                     ///< above: a rung down; 8 degrees below it counts as calm
  rt::TimeNs calm_ns = 10'000'000'000;           ///< so long must all be well before a rung up; doubles after a relapse
  int input_px = 416, small_input_px = 320;      ///< sides of squares of as many pixels as the networks' inputs
  int period_frames = 3;                         ///< shortest time between two detections
  int long_period_frames = 10;                   ///< the same from kLongPeriod on
  double few_features = 0.6;                     ///< share of the tracker's features from kFewFeatures on
  rt::TimeNs mask_age_ns = 400'000'000;          ///< a mask should not grow older than this
  rt::TimeNs detector_stuck_ns = 2'000'000'000;  ///< a detection that takes longer is given up on
};

/// One rung left for another.
struct RungChange {
  rt::TimeNs t_ns = 0;
  Rung from = Rung::kFull, to = Rung::kFull;
  RungReason reason = RungReason::kCalm;
  double value = 0, limit = 0;  ///< the figure behind the reason: slips, ms, degrees
};

/// What is to be done now.
struct SchedulePlan {
  Rung rung = Rung::kFull;
  double feature_share = 1;  ///< of the features that the tracker would measure
  bool detector_on = false;
  int input_px = 0;
  rt::TimeNs period_ns = 0;  ///< between two detections
};

/// One detection to do.
struct DetectorOrder {
  int input_px = 0;
};

struct SchedulerCounters {
  std::uint64_t frames = 0;
  std::uint64_t slips = 0;    ///< poses that stood later than the deadline
  std::uint64_t dropped = 0;  ///< frames dropped because the tracker was busy with an older one
  std::uint64_t steps_down = 0, steps_up = 0;
  std::array<std::uint64_t, kRungReasons> by_reason{};
  std::array<rt::TimeNs, kRungs> time_on_rung_ns{};
  std::uint64_t detections = 0;         ///< orders that came back
  std::uint64_t detections_failed = 0;  ///< of these: without a mask
  std::uint64_t detections_late = 0;    ///< of these: longer after their order than a mask should be old
  std::uint64_t detector_stuck = 0;     ///< times it was given up on
  /// Keyframes that came while the detector was busy: it looks at the newest picture when it is done.
  std::uint64_t keyframes_undetected = 0;
};

/// Time between two detections that take took_ns each, at least shortest_ns: a slow detector gets a fifth of its time
/// as a pause, so that the mapper comes to its turn.
constexpr rt::TimeNs detection_period_ns(rt::TimeNs shortest_ns, rt::TimeNs took_ns) {
  return std::max(shortest_ns, took_ns / 4 * 5);
}
/// Age of such a detector's mask at its oldest: a period and a detection after its picture, just before the next comes.
constexpr rt::TimeNs oldest_mask_ns(rt::TimeNs period_ns, rt::TimeNs took_ns) {
  return period_ns + took_ns;
}

/// Steers by what it is told. One thread; no allocation, bounded.
class Scheduler {
 public:
  explicit Scheduler(const SchedulerOptions& options) : options_(options), calm_needed_ns_(options.calm_ns) {}

  /// A frame went through the tracker: its processing took tracker_ns (negative: it was not tracked, and initialising
  /// or searching costs what it costs), it was done late_ns after its delivery (what the camera takes to deliver is
  /// nothing that shedding would mend); `dropped` older frames gave way to it.
  /// Returns the change of rung that follows from it, if any.
  std::optional<RungChange> frame_done(rt::TimeNs now_ns, rt::TimeNs tracker_ns, rt::TimeNs late_ns, int dropped);

  /// How the machine is, whenever it was looked at. temperature_c: hottest, not-a-number where unknown.
  void machine(double temperature_c, bool throttled);

  /// Shall the picture at hand go to the detector now? keyframe: it is one, and does not wait for the period, only for
  /// the detector's pause, from kLongPeriod on for the period of the rungs above. An order given counts as under way
  /// until detection_done().
  std::optional<DetectorOrder> order(rt::TimeNs now_ns, bool keyframe);
  /// A keyframe came and went.
  void keyframe_undetected() { ++counters_.keyframes_undetected; }
  /// The detection under way has ended; its mask is of the frame captured at t_capture_ns. failed: there is no mask.
  void detection_done(rt::TimeNs now_ns, rt::TimeNs t_capture_ns, bool failed);

  SchedulePlan plan() const;
  Rung rung() const { return rung_; }
  /// The detector holds an order for longer than detector_stuck_ns. It gets no other until it returns that one.
  bool detector_stuck() const { return stuck_; }
  /// Age of the newest mask; negative: there is none yet.
  rt::TimeNs mask_age_ns(rt::TimeNs now_ns) const { return t_mask_ns_ < 0 ? -1 : now_ns - t_mask_ns_; }
  /// Of the newest frames since the last change of rung; 0 while there are too few to tell.
  rt::TimeNs tracker_p95_ns() const { return p95_ns_; }
  const SchedulerCounters& counters() const { return counters_; }

 private:
  static constexpr std::size_t kWindow = 120;  ///< frames behind p95
  static constexpr std::size_t kEnough = 30;   ///< fewer say nothing
  /// Slips within kSlipWindowNs (60 frames of a camera of 30 a second) before a rung is left: a tenth of the poses,
  /// and a third before the detector goes, because a flight among movers without masks loses its map, and a late pose
  /// is only late.
  static constexpr int kSlipsToStep = 6;
  static constexpr int kSlipsToGoBlind = 20;
  static constexpr rt::TimeNs kSlipWindowNs = 2 * rt::kNsPerSecond;
  static constexpr rt::TimeNs kSettleNs = 2 * rt::kNsPerSecond;  ///< a step shows its effect before the next is taken
  static constexpr int kLongestCalm = 16;                        ///< times calm_ns, after relapses
  static constexpr double kCalmShare = 0.75;                     ///< of the limit of p95: below it all is well
  static constexpr double kCalmDegrees = 8;

  void measure(rt::TimeNs tracker_ns);
  /// The next rung down that has an effect; none: there is nothing left to shed.
  std::optional<Rung> next_down() const;
  /// The newest `count` slips came within kSlipWindowNs.
  bool slipped_often(rt::TimeNs now_ns, int count) const;
  std::optional<RungChange> down(rt::TimeNs now_ns, RungReason reason, double value, double limit);
  std::optional<RungChange> up(rt::TimeNs now_ns);
  RungChange change(rt::TimeNs now_ns, Rung to, RungReason reason, double value, double limit);
  bool useful(Rung rung) const;
  rt::TimeNs expected_ns(int input_px) const;
  rt::TimeNs period_for(int input_px) const;

  const SchedulerOptions options_;
  SchedulerCounters counters_;
  Rung rung_ = Rung::kFull;
  std::array<rt::TimeNs, kWindow> costs_{};
  std::size_t cost_count_ = 0;
  rt::TimeNs p95_ns_ = 0;
  std::array<rt::TimeNs, kSlipsToGoBlind> slips_{};  ///< when the newest were
  int slip_count_ = 0;                               ///< since the last change of rung
  rt::TimeNs t_last_ns_ = -1, t_changed_ns_ = 0, t_calm_since_ns_ = -1;
  rt::TimeNs t_climbed_ns_ = -1;
  rt::TimeNs t_tracked_ns_ = 0;  ///< when a frame was tracked last
  rt::TimeNs calm_needed_ns_;
  double temperature_c_ = 0;
  bool throttled_ = false;

  bool ordered_ = false, stuck_ = false;
  bool hung_before_ = false;  ///< the detection before this one did
  rt::TimeNs t_ordered_ns_ = -1;
  int ordered_px_ = 0;
  rt::TimeNs t_mask_ns_ = -1;
  double cost_per_px2_ = 0;  ///< smoothed time of a detection over the square of its input [ns]
  bool large_ = true;        ///< the input that fits the mask's age at present
};

}  // namespace godwit::app
