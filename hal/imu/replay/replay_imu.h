// A recorded inertial sensor as an Imu: its samples at the times that the recording's camera sets.
#pragma once

#include <cstddef>

#include "hal/imu/replay/imu_record.h"
#include "hal/replay_time.h"

namespace godwit::hal {

/// See Imu. Samples from before the camera's first picture are left out; before that picture nothing comes. No
/// allocation, no lock; next() sleeps at real pace only.
class ReplayImu final : public Imu {
 public:
  /// real_pace: a sample comes when it is due, as if it had just been measured; false: at once. time outlives it.
  ReplayImu(ImuRecord record, const ReplayTime* time, bool real_pace)
      : record_(std::move(record)), time_(time), real_pace_(real_pace) {}

  double rate_hz() const override { return record_.rate_hz; }
  ImuStatus next(ImuSample* sample, rt::TimeNs timeout_ns) override;

 private:
  const ImuRecord record_;
  const ReplayTime* time_;
  const bool real_pace_;
  std::size_t next_ = 0;
};

}  // namespace godwit::hal
