// Whether poses come: when their silence is an error.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>

#include "hal/rt/time.h"

namespace godwit::link {

struct PosePatience {
  /// Silence for longer is an error, told within 100 ms of the last pose: 80, and up to 15 for the way out behind an
  /// ODOMETRY at 1 Mbit/s. A single picture lost at 30 a second (a gap of 67 ms) is none.
  rt::TimeNs silence_ns = 80 * rt::kNsPerMs;
  /// A pose whose picture is being worked on may take so long. With the two before it the autopilot hears something
  /// every 300 ms, as ArduPilot wants.
  rt::TimeNs late_ns = 150 * rt::kNsPerMs;
  /// A camera that never gave a picture since the start is a failed one, too.
  rt::TimeNs first_ns = 3 * rt::kNsPerSecond;
};

/// The link thread's, but for frame_begun() and picture_repeated().
class PoseWatch {
 public:
  explicit PoseWatch(const PosePatience& patience) : patience_(patience) {}

  void begin(rt::TimeNs now_ns) { t_last_ns_ = now_ns; }
  /// A good sample came: a pose, or the word that there is none.
  void came(rt::TimeNs now_ns) {
    any_ = true;
    t_last_ns_ = now_ns;
  }
  /// Tracker thread: a picture is being worked on from now on.
  void frame_begun(rt::TimeNs now_ns) { t_begun_ns_.store(now_ns, std::memory_order_relaxed); }
  /// Tracker thread: the picture is the one before, bit for bit, which is no loss as long as the odometry's state
  /// stands (vo::HealthOptions::frozen_ns): nothing is told, and that is no silence.
  void picture_repeated(rt::TimeNs now_ns) {
    t_repeated_ns_.store(now_ns, std::memory_order_relaxed);
    repeated_.fetch_add(1, std::memory_order_relaxed);
  }
  std::uint64_t repeated() const { return repeated_.load(std::memory_order_relaxed); }

  bool any() const { return any_; }
  /// When the poses that do not come become an error.
  rt::TimeNs t_silence_ns() const {
    if (!any_) return t_last_ns_ + patience_.first_ns;
    const rt::TimeNs heard = std::max(t_last_ns_, t_repeated_ns_.load(std::memory_order_relaxed));
    const rt::TimeNs t = heard + patience_.silence_ns;
    const rt::TimeNs begun = t_begun_ns_.load(std::memory_order_relaxed);
    return begun > heard && begun < t ? std::max(t, begun + patience_.late_ns) : t;
  }
  bool stalled(rt::TimeNs now_ns) const { return now_ns >= t_silence_ns(); }

 private:
  const PosePatience patience_;
  bool any_ = false;
  rt::TimeNs t_last_ns_ = 0;  ///< arrival of the newest good sample
  // Tracker -> link thread; relaxed, each stands for itself.
  std::atomic<rt::TimeNs> t_begun_ns_{0};
  std::atomic<rt::TimeNs> t_repeated_ns_{0};
  std::atomic<std::uint64_t> repeated_{0};
};

}  // namespace godwit::link
