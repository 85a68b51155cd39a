// Whether the vehicle is armed, by ArmingStatus on the bus and by the autopilot's HEARTBEAT.
#pragma once

#include "hal/rt/time.h"

namespace godwit::link {

/// One thread; time is an argument.
class ArmingWatch {
 public:
  /// ArmingStatus came from the autopilot's node.
  void heard_status(bool armed, rt::TimeNs now_ns) {
    status_armed_ = armed;
    t_status_ns_ = now_ns;
  }
  /// The newest HEARTBEAT's word and time (0: never) are given. Armed while the newest word says so; and for as long as
  /// nobody says otherwise, because an autopilot that falls silent may still be flying.
  bool armed(bool heartbeat_armed, rt::TimeNs t_heartbeat_ns, rt::TimeNs now_ns) const {
    const bool by_status = t_status_ns_ != 0 && status_armed_;
    const bool by_heartbeat = t_heartbeat_ns != 0 && heartbeat_armed;
    if (by_status == by_heartbeat) return by_status;
    const rt::TimeNs t_yes = by_status ? t_status_ns_ : t_heartbeat_ns;
    const rt::TimeNs t_no = by_status ? t_heartbeat_ns : t_status_ns_;
    const bool outdated = now_ns - t_yes > kOutdatedNs && t_no > t_yes;
    return !outdated;
  }

 private:
  static constexpr rt::TimeNs kOutdatedNs = 5 * rt::kNsPerSecond;
  bool status_armed_ = false;
  rt::TimeNs t_status_ns_ = 0;
};

}  // namespace godwit::link
