#include "hal/imu/replay/replay_imu.h"

#include <algorithm>

#include "hal/rt/wake_up.h"

namespace godwit::hal {
namespace {
/// How often it looks whether the camera has begun.
constexpr rt::TimeNs kLookNs = 5 * rt::kNsPerMs;
}  // namespace

ImuStatus ReplayImu::next(ImuSample* sample, rt::TimeNs timeout_ns) {
  const std::optional<rt::TimeNs> offset = time_->offset_ns();
  if (!offset) {
    if (real_pace_) rt::sleep_until_ns(rt::monotonic_now_ns() + std::min(timeout_ns, kLookNs));
    return ImuStatus::kTimeout;
  }
  while (next_ < record_.samples.size() && record_.samples[next_].t_ns < time_->first_ns()) ++next_;
  if (next_ == record_.samples.size()) return ImuStatus::kEnd;
  const rt::TimeNs due = record_.samples[next_].t_ns + *offset;
  if (real_pace_) {
    const rt::TimeNs give_up = rt::monotonic_now_ns() + timeout_ns;
    rt::sleep_until_ns(std::min(due, give_up));
    if (due > give_up) return ImuStatus::kTimeout;
  }
  *sample = record_.samples[next_++];
  sample->t_ns = due;
  return ImuStatus::kSample;
}

}  // namespace godwit::hal
