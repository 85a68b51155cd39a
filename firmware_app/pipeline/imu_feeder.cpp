#include "firmware_app/pipeline/imu_feeder.h"

namespace godwit::app {
namespace {
/// Clocks that are the same differ by less; a sensor's clock that runs ahead by more is not ours.
constexpr rt::TimeNs kSamplesFutureNs = 20 * rt::kNsPerMs;
}  // namespace

hal::ImuStatus ImuFeeder::next(hal::ImuSample* sample, rt::TimeNs timeout_ns) {
  const hal::ImuStatus status = imu_->next(sample, timeout_ns);
  if (status == hal::ImuStatus::kFault) ++counters.faults;
  if (status != hal::ImuStatus::kSample) return status;
  const bool goes_back = any_ && sample->t_ns <= t_last_ns_;
  const bool ahead = live_ && sample->t_ns > rt::monotonic_now_ns() + kSamplesFutureNs;
  if (goes_back || ahead) {
    ++counters.implausible;
    return hal::ImuStatus::kFault;
  }
  const double interval_ns = imu_->rate_hz() > 0 ? 1e9 / imu_->rate_hz() : 0;
  if (any_ && interval_ns > 0 && static_cast<double>(sample->t_ns - t_last_ns_) > 1.5 * interval_ns) ++counters.gaps;
  any_ = true;
  t_last_ns_ = sample->t_ns;
  ++counters.samples;
  if ((sample->flags & (hal::kImuGyroSaturated | hal::kImuAccelSaturated)) != 0) ++counters.saturated;
  if (onlooker_ != nullptr) onlooker_->show(*sample, live_);
  return status;
}

bool ImuFeeder::next_until(rt::TimeNs t_ns, hal::ImuSample* sample) {
  if (!held_) held_ = next(&held_sample_, 0) == hal::ImuStatus::kSample;
  if (!held_ || held_sample_.t_ns > t_ns) return false;
  *sample = held_sample_;
  held_ = false;
  return true;
}

}  // namespace godwit::app
