// What the pipeline's records say of north, and of what became of the fixes.
#include "firmware_app/pipeline/earth_poses.h"

#include <cmath>
#include <gtest/gtest.h>

namespace godwit::app {
namespace earth_poses_test {

constexpr rt::TimeNs kPicture = rt::kNsPerSecond / 30;

/// Level and straight on at 3 m/s along the frame's x axis, which points north; a fix at every sixth picture, whose
/// place and velocity are turned by so much.
class Flown {
 public:
  EarthRecord fly(double seconds, double turned_rad = 0) {
    FrameRecord r;
    for (const rt::TimeNs end_ns = t_ns_ + static_cast<rt::TimeNs>(seconds * 1e9); t_ns_ < end_ns; t_ns_ += kPicture) {
      const double way = 3 * rt::to_seconds(t_ns_);
      r = {};
      r.t_capture_ns = t_ns_;
      r.metric = r.tracked = r.has_pose = true;
      r.frame_id = 1;
      r.q_world_cam = {0, 0, 0, 1};
      r.t_world_cam = {way, 0, 0};
      r.velocity = {3, 0, 0};
      if (pictures_++ % 6 == 0) {
        const double east = -std::sin(turned_rad), north = std::cos(turned_rad);
        hal::AidSample s;
        s.kind = hal::AidKind::kSatellites;
        s.t_ns = t_ns_;
        s.value = {way * east, way * north, 0};
        s.sigma = 0.5;
        s.velocity = {3 * east, 3 * north};
        s.velocity_sigma = 0.1;
        earth_.take(s);
      }
      earth_.tell(&r);
    }
    return r.earth;
  }

 private:
  EarthPoses earth_;
  rt::TimeNs t_ns_ = rt::kNsPerSecond;
  int pictures_ = 0;
};

TEST(EarthPoses, TellWhatBecameOfTheFixes) {
  Flown flown;
  EarthRecord earth = flown.fly(0.1);
  EXPECT_EQ(earth.fixes, 1U);
  EXPECT_EQ(earth.fixes_used, 0U) << "one alone, with no picture before it";
  EXPECT_STREQ(north_word(earth), "unknown");
  earth = flown.fly(20);
  EXPECT_STREQ(north_word(earth), "known");
  EXPECT_NEAR(earth.heading, M_PI / 2, 0.02);
  EXPECT_GT(earth.fixes, 95U);
  EXPECT_GT(earth.fixes_used, 95U);
  EXPECT_EQ(earth.fixes_refused, 0U);
  earth = flown.fly(8, 1.5);
  EXPECT_STREQ(north_word(earth), "held");
  EXPECT_GE(earth.fixes_refused, 20U);
  EXPECT_NEAR(earth.heading, M_PI / 2, 0.1) << "whatever they say";
}

}  // namespace earth_poses_test
}  // namespace godwit::app
