// What is told where vision and inertial sensor contradict each other.
#include <array>
#include <functional>
#include <gtest/gtest.h>
#include <string>
#include <utility>

#include "tests/app/flown_poses.h"

namespace godwit::app {
namespace inertial_contradiction_test {

using flown_poses::Flown;
using flown_poses::Vec3;

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

/// In how many of the first 100 pictures it is said that sensor and pictures turn about other axes, and how many have
/// a pose.
std::pair<int, int> named_and_told(Flown* f) {
  std::pair<int, int> out;
  for (int k = 0; k < 100; ++k) {
    const FrameRecord r = f->frame(k);
    out.first += r.reason.view().find("sensor and pictures turn about other axes") != std::string::npos ? 1 : 0;
    out.second += r.has_pose ? 1 : 0;
  }
  return out;
}

// Before, it was "no scale fits", "the vertical is not seen" or absurd biases, by turns.
TEST(InertialPoses, AxesThatAreNotAsConfiguredAreNamed) {
  const auto flipped = [](hal::ImuSample* s) {
    s->gyro_rad_s[2] *= -1;
    s->accel_m_s2[2] *= -1;
  };
  const auto swapped = [](hal::ImuSample* s) {
    std::swap(s->gyro_rad_s[0], s->gyro_rad_s[1]);
    std::swap(s->accel_m_s2[0], s->accel_m_s2[1]);
  };
  const std::array<std::function<void(hal::ImuSample*)>, 2> faults{flipped, swapped};
  for (unsigned seed = 1; seed <= 5; ++seed) {
    for (std::size_t fault = 0; fault < faults.size(); ++fault) {
      Flown f(seed);
      f.spoil_sample_ = faults[fault];
      const auto [named, told] = named_and_told(&f);
      EXPECT_GT(named, 20) << "seed " << seed << ", fault " << fault;
      EXPECT_EQ(told, 0) << "seed " << seed << ", fault " << fault;
    }
  }
}

// Nor a mounting that is a few degrees off: the window finds those.
TEST(InertialPoses, AxesThatAreAsConfiguredAreNotNamed) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    for (const double off_deg : {0.0, 2.0, 5.0}) {
      Flown f(seed);
      const Vec3 axis = f.flight_.random().normalized();
      f.flight_.mounting_.R_body_cam = f.flight_.mounting_.R_body_cam * vo::so3_exp(off_deg * M_PI / 180 * axis);
      const auto [named, told] = named_and_told(&f);
      EXPECT_EQ(named, 0) << "seed " << seed << ", off by " << off_deg;
      EXPECT_GT(told, off_deg < 3 ? 50 : -1) << "seed " << seed << ", off by " << off_deg;
    }
  }
}

}  // namespace inertial_contradiction_test
}  // namespace godwit::app
