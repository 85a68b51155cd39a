#include "firmware_app/pipeline/imu_thread.h"

#include <cmath>

#include "hal/rt/rt_scope.h"

namespace godwit::app {
namespace {
/// How long the IMU may take to answer, and how long it is left alone after a fault.
constexpr rt::TimeNs kImuWaitNs = 50 * rt::kNsPerMs;
constexpr rt::TimeNs kImuFaultNs = rt::kNsPerMs;
}  // namespace

void ImuThread::run(rt::Pulse* pulse) {
  const rt::RtScope real_time;
  hal::ImuStatus status = hal::ImuStatus::kTimeout;
  // Relaxed: nothing is ordered by it, it only ends the loop.
  while (status != hal::ImuStatus::kEnd && !channels_->feeder_done.load(std::memory_order_relaxed)) {
    pulse->beat();
    hal::ImuSample sample;
    status = feeder_.next(&sample, kImuWaitNs);
    if (status == hal::ImuStatus::kSample) {
      camera_->turning(std::hypot(sample.gyro_rad_s[0], sample.gyro_rad_s[1], sample.gyro_rad_s[2]));
      if (tap_ != nullptr) tap_->reading(sample);
      if (!channels_->samples.try_push(sample)) ++feeder_.counters.dropped;
      if (!channels_->readings.try_push(sample)) channels_->readings_lost.fetch_add(1, std::memory_order_relaxed);
    }
    // A device that fails at once must not take the processor.
    if (status == hal::ImuStatus::kFault) rt::sleep_until_ns(rt::monotonic_now_ns() + kImuFaultNs);
  }
}

}  // namespace godwit::app
