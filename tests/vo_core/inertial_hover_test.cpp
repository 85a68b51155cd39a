// What is known of the scale where the motion shows none of it: in a hover it is kept, straight on at one speed it
// becomes less sure, and says so.
#include <cmath>
#include <gtest/gtest.h>

#include "tests/vo_core/inertial_flown.h"

namespace godwit::vo {
namespace inertial_hover_test {

using test::Flight;
using test::Flown;

/// What became of the scale in so many seconds after the sixth: its sigma then and at last, and the largest error in
/// sigmas on the way.
struct Scale {
  double sigma_then = 0, sigma_at_last = 0, most_sigmas = 0;
  bool told_all_along = true;
};

Scale flown_on(Flight* f, int seconds) {
  f->stops_at_ = 6;
  Flown flown(f, true);
  for (int k = 0; k < 160; ++k) flown.frame(k);
  Scale out;
  const auto sigma = [&] {
    return std::sqrt(flown.odometry_->smoother().covariance()(InertialState::kScale, InertialState::kScale));
  };
  out.told_all_along = flown.odometry_->metric();
  out.sigma_then = sigma();
  for (int k = 160; k < 160 + 20 * seconds; ++k) {
    out.told_all_along &= flown.frame(k).valid;
    const double off = flown.odometry_->smoother().newest().log_scale - (std::log(f->scale_) + f->strayed_scale_);
    out.most_sigmas = std::max(out.most_sigmas, std::abs(off) / sigma());
  }
  out.sigma_at_last = sigma();
  return out;
}

TEST(InertialHover, TheScaleIsHeldThroughAMinute) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    Flight f(1.0, 400 + seed);
    f.sways_ = 0.15;
    const Scale scale = flown_on(&f, 60);
    EXPECT_TRUE(scale.told_all_along) << seed;
    EXPECT_LT(scale.most_sigmas, 3) << seed;
  }
}

TEST(InertialHover, AtOneSpeedStraightOnTheScaleBecomesUnknownAndIsToldSo) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    Flight f(1.0, 500 + seed);
    f.cruises_ = 3;
    f.scale_walks_ = 1e-3;
    const Scale scale = flown_on(&f, 32);
    EXPECT_LT(scale.most_sigmas, 3) << seed;
    EXPECT_GT(scale.sigma_at_last, 2 * scale.sigma_then) << seed;
  }
}

}  // namespace inertial_hover_test
}  // namespace godwit::vo
