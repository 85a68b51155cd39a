#include "hal/imu/replay/replay_imu.h"

#include <gtest/gtest.h>

#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"

namespace godwit::hal::replay_imu_test {
namespace {

/// `count` samples, one each 5 ms from 100 s on.
ImuRecord record_of(int count) {
  ImuRecord r;
  r.rate_hz = 200;
  for (int i = 0; i < count; ++i) {
    ImuSample s;
    s.t_ns = 100 * rt::kNsPerSecond + i * 5 * rt::kNsPerMs;
    s.gyro_rad_s[0] = i;
    r.samples.push_back(s);
  }
  return r;
}

TEST(ReplayImu, ComesInTheCamerasTimeFromItsFirstPictureOn) {
  ReplayTime time;
  ReplayImu imu(record_of(5), &time, false);
  ImuSample s;
  EXPECT_EQ(imu.next(&s, 0), ImuStatus::kTimeout) << "the camera has not begun";
  time.pin(100 * rt::kNsPerSecond + 9 * rt::kNsPerMs, rt::kNsPerSecond);
  ASSERT_EQ(imu.next(&s, 0), ImuStatus::kSample);
  EXPECT_EQ(s.gyro_rad_s[0], 2) << "0 and 1 were before";
  EXPECT_EQ(s.t_ns, rt::kNsPerSecond + rt::kNsPerMs);
  EXPECT_EQ(imu.next(&s, 0), ImuStatus::kSample);
  EXPECT_EQ(imu.next(&s, 0), ImuStatus::kSample);
  EXPECT_EQ(imu.next(&s, 0), ImuStatus::kEnd);
  EXPECT_EQ(imu.next(&s, 0), ImuStatus::kEnd);
}

TEST(ReplayImu, AtRealPaceNoSampleComesBeforeItWasMeasured) {
  ReplayTime time;
  ReplayImu imu(record_of(20), &time, true);
  ImuSample s;
  EXPECT_EQ(imu.next(&s, rt::kNsPerMs), ImuStatus::kTimeout);
  const rt::TimeNs start = rt::monotonic_now_ns();
  time.pin(100 * rt::kNsPerSecond, start + 30 * rt::kNsPerMs);
  EXPECT_EQ(imu.next(&s, 0), ImuStatus::kTimeout) << "not due";
  int samples = 0;
  for (ImuStatus status = ImuStatus::kTimeout; status != ImuStatus::kEnd;) {
    status = imu.next(&s, 2 * rt::kNsPerMs);
    if (status != ImuStatus::kSample) continue;
    EXPECT_EQ(s.t_ns, start + (30 + 5 * samples) * rt::kNsPerMs);
    EXPECT_GE(rt::monotonic_now_ns(), s.t_ns);
    ++samples;
  }
  EXPECT_EQ(samples, 20);
}

TEST(ReplayImu, NextDoesNotAllocate) {
  ReplayTime time;
  time.pin(100 * rt::kNsPerSecond, rt::kNsPerSecond);
  ReplayImu imu(record_of(100), &time, false);
  const rt::RtScope real_time;
  const rt::HeapCounts before = rt::rt_heap_counts();
  ImuSample s;
  while (imu.next(&s, 0) == ImuStatus::kSample) {
  }
  EXPECT_EQ(rt::rt_heap_counts().allocations, before.allocations);
}

}  // namespace
}  // namespace godwit::hal::replay_imu_test
