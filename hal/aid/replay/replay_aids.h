// Recorded rangefinder, barometer, satellites and attitude as an AidSource: at the times that the recording's camera
// sets.
#pragma once

#include <cstddef>

#include "hal/aid/replay/aid_record.h"
#include "hal/replay_time.h"

namespace godwit::hal {

/// See AidSource. Before the camera's first picture nothing comes.
class ReplayAids final : public AidSource {
 public:
  /// time outlives it.
  ReplayAids(AidRecord record, const ReplayTime* time) : record_(std::move(record)), time_(time) {}

  bool next_until(rt::TimeNs t_ns, AidSample* sample) override {
    const std::optional<rt::TimeNs> offset = time_->offset_ns();
    if (!offset || next_ == record_.size() || record_[next_].t_ns + *offset > t_ns) return false;
    *sample = record_[next_++];
    sample->t_ns += *offset;
    return true;
  }

 private:
  const AidRecord record_;
  const ReplayTime* time_;
  std::size_t next_ = 0;
};

}  // namespace godwit::hal
