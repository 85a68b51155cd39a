// What is told where vision and inertial sensor contradict each other.
#include <array>
#include <functional>
#include <gtest/gtest.h>

#include "tests/app/flown_poses.h"

namespace godwit::app {
namespace inertial_contradiction_test {

using flown_poses::Flown;

TEST(InertialPoses, ASensorThatContradictsWhatIsSeenIsNotGoneOnFrom) {
  const auto stuck = [held = hal::ImuSample()](hal::ImuSample* s) mutable {
    if (held.t_ns == 0) held = *s;
    s->gyro_rad_s = held.gyro_rad_s;
    s->accel_m_s2 = held.accel_m_s2;
  };
  const auto stepped = [](hal::ImuSample* s) {
    for (double& w : s->gyro_rad_s) w += 0.1;
    for (double& a : s->accel_m_s2) a += 1;
  };
  const std::array<std::function<void(hal::ImuSample*)>, 2> faults{stuck, stepped};
  for (std::size_t fault = 0; fault < faults.size(); ++fault) {
    SCOPED_TRACE(fault);
    Flown f(7);
    for (int k = 0; k < 100; ++k) f.frame(k);
    f.spoil_sample_ = faults[fault];
    int without = 0;
    for (int k = 100; k < 200; ++k) {
      const FrameRecord r = f.frame(k);
      // All of it is seen: nothing is told by the sensor alone, which is what went wrong.
      EXPECT_NE(r.state, vo::State::kCoasting) << k << ": " << r.reason.view();
      if (r.has_pose) continue;
      ++without;
      EXPECT_FALSE(r.reason.view().empty()) << k;
    }
    EXPECT_GT(without, 5) << "nothing was noticed";
  }
}

}  // namespace inertial_contradiction_test
}  // namespace godwit::app
