// When poses leave: in step with VIO_RATE, as far apart as the autopilot takes them, with stamps that only grow.
#pragma once

#include <cstdint>

#include "hal/rt/time.h"

namespace godwit::link {

/// One thread; time is an argument.
class PosePacing {
 public:
  /// Poses follow each other by that much at least: ArduPilot drops what arrives within 20 ms of the one before.
  static constexpr rt::TimeNs kMinGapNs = 21 * rt::kNsPerMs;
  /// A pose that comes later than this may find its time taken by a word that there is none.
  static constexpr rt::TimeNs kLatestPoseNs = 250 * rt::kNsPerMs;

  void begin(rt::TimeNs now_ns) { t_last_sent_ns_ = now_ns - rt::kNsPerSecond; }

  /// Whether a pose captured then is one of those that VIO_RATE asks for. One is due when its capture time has come
  /// within a quarter period of the plan, so that a camera of the same rate loses none to jitter, and a faster one is
  /// thinned evenly.
  bool due(rt::TimeNs t_capture_ns, rt::TimeNs period_ns);
  /// Poses that come bunched after a delay leave as far apart as the autopilot takes them.
  bool far_enough(rt::TimeNs now_ns) const { return now_ns - t_last_sent_ns_ >= kMinGapNs; }
  /// Whether it is time to say once more that there is no pose.
  bool silence_due(rt::TimeNs now_ns, rt::TimeNs period_ns) const { return now_ns - t_last_sent_ns_ >= period_ns; }
  /// The stamp of a word without a picture: such that a pose which comes after all is later still.
  rt::TimeNs silence_stamp_ns(rt::TimeNs now_ns) const {
    const rt::TimeNs next = t_last_stamp_ns_ + rt::kNsPerMs, latest = now_ns - kLatestPoseNs;
    return next > latest ? next : latest;
  }
  /// The stamp of a word that there is no pose, for a picture: its own, or later than a pose that was carried past it.
  rt::TimeNs stamp_without_pose_ns(rt::TimeNs t_capture_ns) const {
    const rt::TimeNs next = t_last_stamp_ns_ + rt::kNsPerMs;
    return next > t_capture_ns ? next : t_capture_ns;
  }
  /// False: a message with this stamp would repeat or go back, in the microseconds that are sent.
  bool grows(rt::TimeNs t_stamp_ns) const { return t_stamp_ns / 1000 > t_last_stamp_ns_ / 1000; }
  void sent(rt::TimeNs t_stamp_ns, rt::TimeNs now_ns) {
    t_last_sent_ns_ = now_ns;
    t_last_stamp_ns_ = t_stamp_ns;
  }

 private:
  rt::TimeNs t_next_due_ns_ = 0;  ///< capture time from which the next pose is due
  rt::TimeNs t_last_sent_ns_ = 0;
  rt::TimeNs t_last_stamp_ns_ = 0;
};

}  // namespace godwit::link
