// Metres and the vertical without an inertial sensor: what is told, how sure, and what is refused.
#include "vo_core/inertial/aided_odometry.h"

#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <string>

#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"
#include "tests/vo_core/aided_flown.h"
#include "tests/vo_core/scale_source_name.h"

namespace godwit::vo {
namespace aided_odometry_test {

using test::AidedFlown;
using test::scale_source_name;
using Source = ScaleSource;
using Sources = std::vector<Source>;

constexpr double kDegree = M_PI / 180;

TEST(AidedOdometry, AnAttitudeAndALengthMakePosesMetricWithinWhatIsTold) {
  for (const Source source : {Source::kRange, Source::kBarometer, Source::kSatellites}) {
    double place = 0, attitude = 0;
    int n = 0, begun = 0;
    constexpr int kFlights = 20;
    for (unsigned seed = 1; seed <= kFlights; ++seed) {
      AidedFlown f(seed);
      for (int k = 0; k < 800; ++k) {
        const MetricPose told = f.frame(k, {source});
        if (!told.valid || k % 40 != 0) continue;
        const auto off = f.off(k / 20.0, told);
        place += off.place;
        attitude += off.attitude;
        ++n;
      }
      begun += f.odometry_->metric() ? 1 : 0;
      EXPECT_EQ(f.odometry_->begun(), 1u) << "one frame";
      EXPECT_GT(f.odometry_->scale().share(source), 0.99);
    }
    EXPECT_EQ(begun, kFlights) << scale_source_name(source);
    ASSERT_GT(n, kFlights * 5);
    RecordProperty(scale_source_name(source), std::to_string(place / n) + ", " + std::to_string(attitude / n));
    // Of a mean the autopilot's error and the mounting's are told whole, which is more than a mean is off by.
    EXPECT_LT(place / n, 1.5) << scale_source_name(source);
    EXPECT_GT(place / n, 0.05) << scale_source_name(source);
    EXPECT_LT(attitude / n, 1.5) << scale_source_name(source);
    EXPECT_GT(attitude / n, 0.05) << scale_source_name(source);
  }
}

TEST(AidedOdometry, AConfiguredHeightAloneIsEnoughAndSaysHowLittleItKnows) {
  for (const double wrong : {0.9, 1.0, 1.15}) {
    AidedFlown f(3);
    AidReading height;
    height.source = Source::kStartHeight;
    height.value_m.z() = wrong * f.camera(0).t.z();
    ASSERT_TRUE(f.odometry_->take(height));
    MetricPose told;
    for (int k = 0; k < 400; ++k) told = f.frame(k, {});
    ASSERT_TRUE(told.valid) << f.odometry_->refusal().text;
    EXPECT_EQ(f.odometry_->scale().share(Source::kStartHeight), 1);
    EXPECT_GT(told.log_scale_sigma, 0.15);
    // A vertical that is off by a degree lifts the ground 25 m ahead by 3 % of the height.
    EXPECT_NEAR(f.odometry_->scale().scale() / f.scale_, wrong, 0.05);
    // And a rangefinder overrules it.
    for (int k = 400; k < 700; ++k) told = f.frame(k, {Source::kRange});
    EXPECT_LT(told.log_scale_sigma, 0.08);
    EXPECT_LT(std::abs(std::log(f.odometry_->scale().scale() / f.scale_)), 3 * told.log_scale_sigma);
  }
}

TEST(AidedOdometry, WithoutAttitudeOrLengthNothingIsToldAndItSaysWhatIsMissing) {
  AidedFlown without_length(1);
  for (int k = 0; k < 300; ++k) ASSERT_FALSE(without_length.frame(k, {}).valid);
  EXPECT_EQ(std::string(without_length.odometry_->refusal().text),
            "nobody tells the scale well enough: its sigma [0.1 %]");
  EXPECT_TRUE(without_length.odometry_->attitude_heard());

  AidedFlown without_vertical(1);
  without_vertical.silent_ = true;
  for (int k = 0; k < 300; ++k)
    ASSERT_FALSE(without_vertical.frame(k, {Source::kRange, Source::kBarometer, Source::kSatellites}).valid);
  EXPECT_EQ(std::string(without_vertical.odometry_->refusal().text), "waiting for the autopilot's attitude");
  EXPECT_FALSE(without_vertical.odometry_->attitude_heard());
}

TEST(AidedOdometry, AnAttitudeThatLiesForASecondIsLeftOut) {
  AidedFlown f(5);
  MetricPose told;
  for (int k = 0; k < 400; ++k) {
    f.attitude_lie_ = k >= 200 && k < 230 ? Vec3(20 * kDegree, 0, 0) : Vec3(Vec3::Zero());
    told = f.frame(k, {Source::kRange});
    if (k < 200) continue;
    ASSERT_TRUE(told.valid) << k;
    EXPECT_LT(f.tilt(k / 20.0, told), 3 * std::sqrt(told.covariance.diagonal().tail<3>().sum()));
  }
  EXPECT_GE(f.odometry_->vertical().contradictions(), 14u);
  EXPECT_EQ(f.odometry_->begun(), 1u);
}

TEST(AidedOdometry, AnAttitudeThatGoesOnLyingIsNoVerticalAnyMore) {
  AidedFlown f(6);
  for (int k = 0; k < 200; ++k) f.frame(k, {Source::kRange});
  ASSERT_TRUE(f.odometry_->metric());
  f.attitude_lie_ = Vec3(0, -12 * kDegree, 0);
  int told = 0;
  for (int k = 200; k < 240 + 580; ++k) told += f.frame(k, {Source::kRange}).valid ? 1 : 0;
  EXPECT_LE(told, 45) << "two seconds of doubt, and then half a minute of silence";
  EXPECT_EQ(std::string(f.odometry_->refusal().text), "the autopilot's attitude contradicts the pictures");
  EXPECT_EQ(f.odometry_->vertical().given_up(), 1u);
  f.attitude_lie_.setZero();
  MetricPose again;
  for (int k = 820; k < 1000; ++k) again = f.frame(k, {Source::kRange});
  ASSERT_TRUE(again.valid) << "who fits again is heard again";
  EXPECT_LT(f.tilt(999 / 20.0, again), 4 * kDegree);
  EXPECT_EQ(f.odometry_->begun(), 2u) << "and that is another frame";
}

TEST(AidedOdometry, TheFirstAttitudeMayBeTheWrongOne) {
  AidedFlown f(8);
  MetricPose told;
  for (int k = 0; k < 100; ++k) {
    f.attitude_lie_ = k < 4 ? Vec3(1, 0, 0) : Vec3(Vec3::Zero());
    told = f.frame(k, {Source::kRange});
  }
  ASSERT_TRUE(told.valid) << f.odometry_->refusal().text;
  EXPECT_LT(f.tilt(99 / 20.0, told), 4 * kDegree);
}

TEST(AidedOdometry, ARangefinderThatLiesForASecondIsLeftOut) {
  AidedFlown f(7, 0);
  MetricPose told;
  for (int k = 0; k < 800; ++k) {
    f.range_lie_ = k >= 400 && k < 440 ? -8 : 0;
    told = f.frame(k, {Source::kRange});
    if (k < 400) continue;
    ASSERT_TRUE(told.valid) << k;
    EXPECT_LT(std::abs(std::log(f.odometry_->scale().scale() / f.scale_)), 3 * told.log_scale_sigma) << k;
  }
  EXPECT_GE(f.odometry_->scale().count(Source::kRange, ScaleVerdict::kContradicts), 1u);
}

// Level and straight a barometer says nothing of lengths, and satellites that ended say nothing at all.
TEST(AidedOdometry, WhereNothingTellsTheScaleItsSigmaGrows) {
  for (const Source source : {Source::kBarometer, Source::kSatellites}) {
    AidedFlown f(9);
    f.level_after_ = 30;
    for (int k = 0; k < 600; ++k) f.frame(k, {source});
    ASSERT_TRUE(f.odometry_->metric()) << scale_source_name(source);
    // What was measured over the last climb still comes in.
    int k = 600;
    const Sources after = source == Source::kBarometer ? Sources{source} : Sources{};
    for (; k < 1300; ++k) f.frame(k, after);
    const double sigma = f.odometry_->scale().log_sigma();
    double last = sigma;
    MetricPose told;
    for (; k < 1300 + 2400; ++k) {
      told = f.frame(k, after);
      ASSERT_TRUE(told.valid);
      EXPECT_GE(told.log_scale_sigma, last) << k;
      last = told.log_scale_sigma;
    }
    const double walk = ScaleOptions{}.scale_walk;
    EXPECT_GT(last * last, sigma * sigma + 0.99 * 120 * walk * walk) << scale_source_name(source);
  }
}

TEST(AidedOdometry, ANewMapBeginsUnknownAndGoesOnWhereTheLastEnded) {
  AidedFlown f(11);
  MetricPose last;
  for (int k = 0; k < 300; ++k) last = f.frame(k, {Source::kRange});
  ASSERT_TRUE(last.valid);
  f.map_id_ = 2;
  f.scale_ = 3;
  f.R_map_world_ = so3_exp(Vec3(0.4, -0.2, 1.1)) * f.R_map_world_;
  EXPECT_FALSE(f.frame(300, {Source::kRange}).valid);
  MetricPose told;
  int k = 301;
  while (k < 400 && !told.valid) told = f.frame(k++, {Source::kRange});
  ASSERT_TRUE(told.valid);
  EXPECT_GT(k, 310) << "vertical and scale must be shown first";
  EXPECT_EQ(f.odometry_->begun(), 2u);
  EXPECT_LT((told.T_nav_cam.t - last.T_nav_cam.t).norm(), 1e-9);
  const Vec3 ahead = told.T_nav_cam.R.col(2), then = last.T_nav_cam.R.col(2);
  EXPECT_NEAR(std::atan2(ahead.y(), ahead.x()), std::atan2(then.y(), then.x()), 1e-9);
  EXPECT_TRUE(told.moved_by_m.isZero()) << "another frame: nothing to be compared";
  EXPECT_NEAR(std::log(f.odometry_->scale().scale() / 3), 0, 0.3);
}

TEST(AidedOdometry, ALossInTheSameMapIsTheSameFrame) {
  AidedFlown f(12);
  for (int k = 0; k < 300; ++k) f.frame(k, {Source::kRange});
  f.tracked_ = false;
  for (int k = 300; k < 400; ++k) EXPECT_FALSE(f.frame(k, {Source::kRange}).valid);
  f.tracked_ = true;
  const MetricPose back = f.frame(400, {Source::kRange});
  ASSERT_TRUE(back.valid);
  EXPECT_EQ(f.odometry_->begun(), 1u);
  EXPECT_LT(f.off(20, back).place, 6);
  // What is known of the speed is not from before the gap.
  EXPECT_GT(back.velocity_covariance(0, 0), 1);
  const MetricPose next = f.frame(402, {Source::kRange});
  EXPECT_LT((next.velocity_m_s.norm() - 3.4), 1.5);
}

TEST(AidedOdometry, ACorrectedMapMovesThePoseAndIsToldAsThat) {
  AidedFlown plain(13), corrected(13);
  // Up to the 15th second vision strays, and then a correction takes it back as of the last picture.
  static Vec3 pivot, moved;
  static const Vec3 kTurn(0.02, -0.03, 0.01), kShift(0.1, 0.05, -0.02);
  static double share;
  static bool corrects;
  corrected.spoil_ = [](VisualPose* pose) {
    const Vec3 camera = pose->T_map_cam.t;
    if (share == 0) pivot = camera;
    const Mat3 turn = so3_exp(share * kTurn);
    pose->T_map_cam = {turn * pose->T_map_cam.R, pivot + turn * (camera - pivot) + share * kShift};
    if (share > 0) moved = camera - pose->T_map_cam.t;
    pose->map_moved = corrects;
    if (!corrects) return;
    pose->moved_by = moved;
    pose->turned_by = -kTurn;
  };
  MetricPose a, b;
  for (int k = 0; k < 500; ++k) {
    share = k < 300 ? std::max(0.0, 1 - (299 - k) / 20.0 / rt::to_seconds(kStrayedNs)) : 0;
    corrects = k == 300;
    a = plain.frame(k, {Source::kSatellites});
    b = corrected.frame(k, {Source::kSatellites});
    if (k != 300) continue;
    ASSERT_TRUE(b.valid);
    EXPECT_NEAR(b.moved_by_m.norm(), plain.odometry_->scale().scale() * moved.norm(), 0.3) << "the place jumps";
  }
  ASSERT_TRUE(a.valid && b.valid);
  EXPECT_EQ(corrected.odometry_->vertical().contradictions(), 0u);
  EXPECT_NEAR(corrected.odometry_->scale().scale(), plain.odometry_->scale().scale(),
              0.02 * plain.odometry_->scale().scale());
  EXPECT_NEAR(corrected.tilt(499 / 20.0, b), plain.tilt(499 / 20.0, a), 0.002);
  EXPECT_LT((a.velocity_m_s - b.velocity_m_s).norm(), 0.15);
}

TEST(AidedOdometry, VelocityIsThatOfTheFlight) {
  AidedFlown f(14, 0);
  double squared = 0;
  int n = 0;
  for (int k = 0; k < 800; ++k) {
    const MetricPose told = f.frame(k, {Source::kRange});
    if (!told.valid || k < 200) continue;
    const double t = k / 20.0, true_speed = (f.camera(t + 1e-3).t - f.camera(t - 1e-3).t).norm() / 2e-3;
    const double sigma2 = told.velocity_m_s.normalized().dot(told.velocity_covariance * told.velocity_m_s.normalized());
    squared += (told.velocity_m_s.norm() - true_speed) * (told.velocity_m_s.norm() - true_speed) / sigma2;
    ++n;
  }
  EXPECT_LT(squared / n, 2);
}

bool finite(const MetricPose& p) {
  return p.T_nav_cam.R.allFinite() && p.T_nav_cam.t.allFinite() && p.covariance.allFinite() &&
         p.velocity_m_s.allFinite() && p.velocity_covariance.allFinite() && p.moved_by_m.allFinite() &&
         p.turned_by_rad.allFinite() && std::isfinite(p.log_scale_sigma);
}

TEST(AidedOdometry, WhatIsNoNumberIsPassedOver) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN(), kInf = std::numeric_limits<double>::infinity();
  AidedFlown f(15);
  AttitudeReading a;
  a.up = Vec3::UnitZ();
  a.sigma_rad = 0.02;
  a.t_ns = 5;
  const auto refused = [&](const auto& spoil) {
    AttitudeReading spoilt = a;
    spoil(&spoilt);
    return !f.odometry_->take(spoilt);
  };
  EXPECT_TRUE(refused([&](AttitudeReading* r) { r->up.x() = kNan; }));
  EXPECT_TRUE(refused([&](AttitudeReading* r) { r->up *= 1e300; }));
  EXPECT_TRUE(refused([](AttitudeReading* r) { r->up.setZero(); }));
  EXPECT_TRUE(refused([&](AttitudeReading* r) { r->sigma_rad = kInf; }));
  EXPECT_TRUE(refused([](AttitudeReading* r) { r->sigma_rad = 0; }));
  EXPECT_TRUE(refused([](AttitudeReading* r) { r->t_ns = 0; }));
  for (int k = 0; k < 400; ++k) {
    if (k > 100 && k % 7 == 0) {
      a.t_ns = AidedFlown::ns(k / 20.0 - 0.04);
      a.up = k % 2 == 0 ? Vec3(kNan, 0, 1) : Vec3(0, 0, kInf);
      EXPECT_FALSE(f.odometry_->take(a));
      AidReading r;
      r.t_ns = a.t_ns;
      r.value_m = Vec3(0, 0, kNan);
      EXPECT_FALSE(f.odometry_->take(r));
    }
    EXPECT_TRUE(finite(f.frame(k, {Source::kRange, Source::kBarometer, Source::kSatellites}))) << k;
  }
  EXPECT_TRUE(f.odometry_->metric());
}

TEST(AidedOdometry, NothingIsAllocated) {
  AidedFlown f(16);
  const Sources sources = {Source::kRange, Source::kBarometer, Source::kSatellites};
  f.frame(0, sources);  // the test's own points
  for (int k = 1; k < 200; ++k) {
    const double t = k / 20.0;
    const VisualPose pose = f.seen(t);
    const rt::RtScope real_time;
    if (k % 2 == 1) f.attitude(t - 0.01);
    for (const Source s : sources) f.read(s, t - 0.02);
    f.odometry_->frame(pose);
  }
  EXPECT_TRUE(f.odometry_->metric());
}

}  // namespace aided_odometry_test
}  // namespace godwit::vo
