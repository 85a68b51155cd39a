// What knows metres beside the inertial sensor, as the odometry hears it: counted, left out, and compared with what is
// known without it.
#include <algorithm>
#include <cmath>
#include <gtest/gtest.h>
#include <memory>

#include "tests/vo_core/inertial_flown.h"

namespace godwit::vo {
namespace inertial_aids_test {

using test::Flight;
using test::Flown;

/// Satellites that know the camera's place to 0.2 mm, in lengths times `lie`, before frame k.
void tell_place(const Flight& f, int k, double lie, InertialOdometry* odometry) {
  const double t = k / 20.0;
  AidReading r;
  r.source = ScaleSource::kSatellites;
  r.t_ns = static_cast<rt::TimeNs>(t * 1e9) - rt::kNsPerMs;
  r.value_m = lie * (f.p(t) + f.R(t) * f.mounting_.t_body_cam_m);
  r.sigma_m = 2e-4;
  odometry->take(r);
}

TEST(InertialOdometry, AMotionThatShowsNoScaleIsMetricWithSatellitesBesideIt) {
  for (const bool told : {false, true}) {
    Flight f(0.02, 15);
    f.bias_.accel.setZero();
    InertialOdometryOptions options;
    options.aids.arm_m = 0;
    options.aids.depth_share = 2e-4;  // what this flight sees errs by less than a real one
    Flown flown(&f);
    options.model = f.model_;
    flown.odometry_ = std::make_unique<InertialOdometry>(f.mounting_, options);
    double scale = 0;
    for (int k = 0; k < 120; ++k) {
      if (told) tell_place(f, k, 1, flown.odometry_.get());
      if (flown.frame(k).valid) scale = flown.odometry_->smoother().newest().scale();
    }
    EXPECT_EQ(flown.odometry_->metric(), told)
        << flown.odometry_->refusal().text << " " << flown.odometry_->refusal().value << ", beside it "
        << flown.odometry_->aided_scale().log_sigma();
    if (told) {
      const auto& C = flown.odometry_->smoother().covariance();
      const double sigma = std::sqrt(C(InertialState::kScale, InertialState::kScale));
      EXPECT_LT(sigma, 0.08);
      EXPECT_LT(std::abs(std::log(scale / f.scale_)), 3 * sigma);
    }
  }
}

TEST(InertialOdometry, SatellitesThatLieAboutLengthsAreLeftOut) {
  Flight f(1.0, 16);
  Flown flown(&f);
  InertialOdometryOptions options;
  options.model = f.model_;
  options.aids.arm_m = 0;
  flown.odometry_ = std::make_unique<InertialOdometry>(f.mounting_, options);
  for (int k = 0; k < 80; ++k) flown.frame(k);
  ASSERT_TRUE(flown.odometry_->metric());
  for (int k = 80; k < 240; ++k) {
    tell_place(f, k, 1.5, flown.odometry_.get());
    flown.frame(k);
  }
  EXPECT_GT(flown.odometry_->aids_contradicted(), 20u);
  EXPECT_NEAR(flown.odometry_->smoother().newest().scale() / f.scale_, 1, 0.03);
}

TEST(InertialOdometry, WhatOthersPulledTheScaleToIsNotWhatTheyAreComparedWith) {
  // They are heard before the window knows anything, and it begins with what they say.
  Flight f(1.0, 17);
  Flown flown(&f);
  InertialOdometryOptions options;
  options.model = f.model_;
  options.aids.arm_m = 0;
  flown.odometry_ = std::make_unique<InertialOdometry>(f.mounting_, options);
  double worst = 0, fits = 0;
  for (int k = 0; k < 240; ++k) {
    tell_place(f, k, 1.12, flown.odometry_.get());
    flown.frame(k);
    worst = std::max(worst, flown.odometry_->aids_off2());
  }
  ASSERT_TRUE(flown.odometry_->metric());
  EXPECT_GT(worst, 16) << "in time the window knows better";
  EXPECT_GT(flown.odometry_->aids_contradicted(), 0u);
  EXPECT_NEAR(flown.odometry_->smoother().newest().scale() / f.scale_, 1, 0.03);
  // Who is right stays within what is expected.
  Flight g(1.0, 17);
  Flown honest(&g);
  honest.odometry_ = std::make_unique<InertialOdometry>(g.mounting_, options);
  int compared = 0;
  for (int k = 0; k < 240; ++k) {
    tell_place(g, k, 1, honest.odometry_.get());
    honest.frame(k);
    if (honest.odometry_->aids_off2() < 0) continue;
    fits += honest.odometry_->aids_off2();
    ++compared;
  }
  EXPECT_GT(compared, 50);
  EXPECT_LT(fits / compared, 3);
  EXPECT_EQ(honest.odometry_->aids_contradicted(), 0u);
}

// A word that is 18 % off and that the window's own opinion, not sure enough yet, does not leave out: both together
// were told surer than either, and more so once nobody spoke any more. Several flights: how far off a single one is
// hangs on the processor's roundings.
TEST(InertialOdometry, TwoThatContradictEachOtherAreTogetherNoSurerThanEachAlone) {
  int wrong = 0, beyond = 0, told = 0;
  double squares = 0;
  for (int seed = 11; seed < 19; ++seed) {
    Flight f(0.1, seed);
    Flown flown(&f);
    InertialOdometryOptions options;
    options.model = f.model_;
    options.told_scale_sigma = 0;
    options.aids.arm_m = 0;
    options.aids.depth_share = 2e-4;  // as above
    flown.odometry_ = std::make_unique<InertialOdometry>(f.mounting_, options);
    for (int k = 0; k < 240; ++k) {
      if (k < 45) tell_place(f, k, 1.18, flown.odometry_.get());
      const MetricPose pose = flown.frame(k);
      if (k < 40) continue;
      ASSERT_TRUE(pose.valid) << k << " of " << seed;
      const double off = std::abs(std::log(flown.odometry_->smoother().newest().scale() / f.scale_));
      ++told;
      squares += (off / pose.log_scale_sigma) * (off / pose.log_scale_sigma);
      if (off > 0.08) ++wrong;
      if (off > 3 * pose.log_scale_sigma) ++beyond;
    }
  }
  EXPECT_GT(wrong, 80) << "it was pulled away, or nothing was shown";
  // 1.06 and 24; with neither told any wider 5.8, and beyond in every one of the 260 where it is wrong.
  EXPECT_LT(squares / told, 2) << "of " << told;
  EXPECT_LT(beyond, told / 25) << wrong << " are wrong";
}

}  // namespace inertial_aids_test
}  // namespace godwit::vo
