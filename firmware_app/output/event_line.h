// What a real-time thread said, as a line for people.
#pragma once

#include <optional>
#include <string>

#include "hal/rt/log_ring.h"

namespace godwit::app {

/// "t=12.43 s TRACKING -> RELOCALISING: too few features 12, limit 30". t counts from t_first_ns.
std::string event_line(const rt::LogEntry& entry, rt::TimeNs t_first_ns);

/// The beginning from which events count: the first picture, or the first event if that was earlier. One thread.
class EventClock {
 public:
  /// Of each picture (capture time) and event, as it comes.
  void heard(rt::TimeNs t_ns) {
    if (!first_ns_) first_ns_ = t_ns;
  }
  rt::TimeNs first_ns() const { return first_ns_.value_or(0); }

 private:
  std::optional<rt::TimeNs> first_ns_;
};

}  // namespace godwit::app
