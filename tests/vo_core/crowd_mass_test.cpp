// What a camera's mass is good for where little of the picture is left between movers: on rendered pictures with exact
// truth.
#include <cmath>
#include <cstddef>
#include <gtest/gtest.h>

#include "tests/vo_core/crowd_flight.h"
#include "vo_core/tracking/tracker.h"

namespace godwit::vo {
namespace crowd_test {

/// Of several flights together.
struct Steps {
  int tracked = 0;
  int steps = 0;     ///< between two tracked frames in a row
  double error = 0;  ///< of their lengths and directions, squares' sum [m^2]

  void add(const Flight& flight, const std::vector<Shot>& order) {
    const double scale = scale_of(flight, order, kFree);
    const auto off = [&](std::size_t i) -> Vec3 {
      return scale * flight.frames[i].T_world_cam.t - (sweep(0) * pose_of(order[i]).inverse()).t;
    };
    for (std::size_t i = kFree; i < order.size(); ++i) {
      if (!flight.frames[i].tracked) continue;
      ++tracked;
      if (i == kFree || !flight.frames[i - 1].tracked) continue;
      ++steps;
      error += (off(i) - off(i - 1)).squaredNorm();
    }
  }
  double rms() const { return std::sqrt(error / steps); }
};

// A fifth of each picture is left, blurred in every second or third: a step aside and a turn look alike there. The
// camera's mass tells which it was.
TEST(CrowdMass, WhatIsSeenInAGapBetweenMoversIsNoStepAside) {
  TrackerOptions massless;
  massless.motion.acceleration = massless.motion.turn_acceleration = 1e6;
  const CameraModel camera = camera_of(640);
  Steps with, without;
  for (const double hidden : {0.78, 0.8}) {
    for (const std::size_t every : {2u, 3u}) {
      auto order = shots({{0, kFree - 1, 0.0}, {kFree, kFree + 29, hidden}});
      for (std::size_t i = kFree; i < order.size(); i += every) order[i].blur = 18;
      with.add(fly(order, {}, camera), order);
      without.add(fly(order, massless, camera), order);
    }
  }
  EXPECT_GT(with.tracked, without.tracked + 4);
  EXPECT_LT(with.rms(), 0.9 * without.rms()) << without.rms();
}

}  // namespace crowd_test
}  // namespace godwit::vo
