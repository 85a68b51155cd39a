// Readings whose times are wrong, as the inertial odometry is given them.
#include <cmath>
#include <gtest/gtest.h>

#include "tests/vo_core/inertial_flown.h"
#include "vo_core/inertial/inertial_odometry.h"

namespace godwit::vo {
namespace inertial_clock_test {

using test::Flight;
using test::Flown;

// What the buffer forgets is summed up to a time, and that time was the wrong one for as long as it lay ahead: ten
// seconds without metres.
TEST(InertialClock, AReadingStampedFarAheadCostsAWindow) {
  Flight flight(1.0, 7);
  Flown flown(&flight, true);
  int without = 0;
  for (int k = 0; k < 260; ++k) {
    if (k == 100) {
      ASSERT_TRUE(flown.odometry_->metric());
      ImuReading ahead = flight.reading(k / 20.0);
      ahead.t_ns += 10 * rt::kNsPerSecond;
      flown.odometry_->add(ahead);
    }
    const MetricPose pose = flown.frame(k);
    if (k < 100) continue;
    without += pose.valid ? 0 : 1;
    if (pose.valid) {
      const double off = flown.odometry_->smoother().newest().log_scale - std::log(flight.scale_);
      EXPECT_LT(std::abs(off), 4 * std::max(pose.log_scale_sigma, 0.01)) << k;
    }
  }
  EXPECT_LT(without, 100);
}

TEST(InertialClock, BothClocksSetBackBeginAnew) {
  Flight flight(1.0, 8);
  Flown flown(&flight, true);
  for (int k = 0; k < 100; ++k) flown.frame(k);
  ASSERT_TRUE(flown.odometry_->metric());
  // The window waited for its time to come again, and what was told meanwhile stood still.
  for (int k = 0; k < 80; ++k) {
    const MetricPose pose = flown.frame(k);
    EXPECT_FALSE(k == 0 && pose.valid);
  }
  EXPECT_TRUE(flown.odometry_->metric());
  const InertialSmoother& window = flown.odometry_->smoother();
  EXPECT_LT(std::abs(window.node(window.size() - 1).t_ns - 79 * 50 * rt::kNsPerMs), 200 * rt::kNsPerMs);
}

}  // namespace inertial_clock_test
}  // namespace godwit::vo
