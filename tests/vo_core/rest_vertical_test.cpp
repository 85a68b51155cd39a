// The vertical of a sensor that rests: when it is one, how far the gyroscope carries it, and how fast one is since.
#include "vo_core/inertial/rest_vertical.h"

#include <cmath>
#include <functional>
#include <gtest/gtest.h>
#include <random>

#include "vo_core/inertial/inertial_factors.h"

namespace godwit::vo {
namespace rest_vertical_test {

/// A sensor of 200 readings a second that is turned and pushed as it is told.
class Sensor {
 public:
  explicit Sensor(unsigned seed) : engine_(seed) {
    bias_.gyro = 0.02 * random();
    bias_.accel = 0.05 * random();
    gyro_scale_ = 1 + 0.02 * random().x();
  }
  /// For so long, turning and speeding up at a constant rate in the body's axes, and shaken.
  void go(double seconds, const Vec3& rate, const Vec3& acceleration, double shake = 0) {
    for (int i = 0; i < std::lround(seconds * 200); ++i) {
      t_ns_ += 5 * rt::kNsPerMs;
      const double root = std::sqrt(200.0);
      const Vec3 up = R_world_body_.transpose() * Vec3::UnitZ();
      ImuReading r{t_ns_, gyro_scale_ * rate + bias_.gyro + noise_.gyro * root * random(),
                   kStandardGravity * up + acceleration + bias_.accel + noise_.accel * root * random() +
                       shake * Vec3(std::sin(0.08 * i), 0, 0)};
      r.gyro_saturated = gyro_ends_;
      r.accel_saturated = accel_ends_;
      buffer_.add(r);
      rest_.add(r);
      if (shown_ && i % 10 == 0) rest_.picture(t_ns_, 1e-3);
      v_world_ += 0.005 * (R_world_body_ * so3_exp(0.0025 * rate) * acceleration);
      R_world_body_ = R_world_body_ * so3_exp(0.005 * rate);
    }
  }
  /// As long on the ground, before pictures that show it.
  void stand(double seconds) {
    shown_ = true;
    go(seconds, Vec3::Zero(), Vec3::Zero());
    shown_ = false;
  }
  KnownVertical now() const { return rest_.at(t_ns_, buffer_); }
  /// What it is off by, the true bias given [rad].
  double off(const KnownVertical& v) const {
    return angle_between((v.up + v.by_bias * bias_.accel).normalized(), R_world_body_.transpose() * Vec3::UnitZ());
  }
  Vec3 random() { return Vec3(normal_(engine_), normal_(engine_), normal_(engine_)); }

  std::mt19937 engine_;
  std::normal_distribution<double> normal_;
  ImuNoise noise_{3e-4, 8e-3, 5e-5, 3e-3};
  ImuBias bias_;
  double gyro_scale_ = 1;
  bool gyro_ends_ = false, accel_ends_ = false;  ///< so it says of its readings
  bool shown_ = false;                           ///< pictures show no motion, whatever there is
  ImuBuffer buffer_;
  RestVertical rest_{noise_, kStandardGravity, 0.1};
  Mat3 R_world_body_ = so3_exp(Vec3(0.3, -0.2, 1));
  Vec3 v_world_ = Vec3::Zero();
  rt::TimeNs t_ns_ = 0;
};

TEST(RestVertical, IsKnownAfterASecondAtRest) {
  Sensor s(1);
  s.stand(0.9);
  EXPECT_FALSE(s.now().known);
  s.stand(0.3);
  ASSERT_TRUE(s.now().known);
  EXPECT_LT(s.off(s.now()), 3 * s.now().sigma);
  EXPECT_LT(s.now().sigma, 3e-3);
}

TEST(RestVertical, IsCarriedByTheGyroscopeWhereItIsTurnedAndPushed) {
  double nees = 0;
  for (unsigned seed = 1; seed <= 20; ++seed) {
    Sensor s(seed);
    s.stand(2);
    const double at_rest = s.now().sigma;
    s.go(1, Vec3(0.3, -0.5, 0.2), Vec3(2, 1, -3));
    s.go(1, Vec3(-0.1, 0.4, 1), Vec3(-1, 4, 2));
    const KnownVertical v = s.now();
    ASSERT_TRUE(v.known);
    EXPECT_LT(s.off(v), 3 * v.sigma) << seed;
    EXPECT_GT(v.sigma, 2 * at_rest) << "the gyroscope has a scale of its own";
    nees += std::pow(s.off(v) / v.sigma, 2) / 2;
  }
  EXPECT_LT(nees / 20, 1.5);
  EXPECT_GT(nees / 20, 0.01);
}

TEST(RestVertical, KnowsHowFastOneHasBecomeSince) {
  double nees = 0;
  for (unsigned seed = 1; seed <= 20; ++seed) {
    Sensor s(seed);
    s.stand(2);
    s.go(1, Vec3(0.1, -0.2, 0.2), Vec3(0.5, 0.3, 2));
    s.go(1.5, Vec3(-0.1, 0.2, 0.3), Vec3(-0.2, 0.3, 0));
    const KnownVertical v = s.now();
    ASSERT_GT(v.velocity_sigma, 0);
    EXPECT_LT(v.velocity_sigma, 0.25) << "of 2 m/s, after turns by 0.85 radians";
    const Vec3 off = s.R_world_body_.transpose() * s.v_world_ - v.velocity - v.velocity_by_bias * s.bias_.accel;
    EXPECT_LT(off.norm(), 4 * v.velocity_sigma) << seed;
    nees += std::pow(off.norm() / v.velocity_sigma, 2) / 3;
    // And of a time before, and carried on from there.
    const rt::TimeNs then_ns = s.t_ns_ - 700 * rt::kNsPerMs;
    KnownVertical on = s.rest_.at(then_ns, s.buffer_);
    Preintegration d(ImuBias{on.gyro_bias, Vec3::Zero()});
    s.buffer_.integrate(then_ns, s.t_ns_, s.noise_, &d);
    on.go_on(d);
    EXPECT_LT((on.velocity - v.velocity).norm(), 5e-3);
    EXPECT_LT((on.velocity_by_bias - v.velocity_by_bias).norm(), 2e-3);
    EXPECT_NEAR(on.velocity_sigma, v.velocity_sigma, 0.35 * v.velocity_sigma);
    // What it read at rest beyond gravity is the bias along it.
    EXPECT_NEAR(v.beyond_gravity, v.up_at_rest.dot(s.bias_.accel), 4 * v.beyond_gravity_sigma);
    EXPECT_LT(v.gyro_bias_sigma, 1e-3);
    EXPECT_LT((v.gyro_bias - s.bias_.gyro).norm(), 4 * v.gyro_bias_sigma);
  }
  EXPECT_LT(nees / 20, 1.5);
  EXPECT_GT(nees / 20, 0.01);
}

TEST(RestVertical, OfATimeWithinTheRestNobodyMoves) {
  Sensor s(3);
  s.bias_.accel = Vec3(0.3, -0.2, 0.25);
  s.stand(3);
  const KnownVertical v = s.rest_.at(s.t_ns_ - 600 * rt::kNsPerMs, s.buffer_);
  ASSERT_GT(v.velocity_sigma, 0);
  EXPECT_LT((v.velocity + v.velocity_by_bias * s.bias_.accel).norm(), 4 * v.velocity_sigma);
}

TEST(RestVertical, OnlyWhatPicturesShowAsWellIsARest) {
  Sensor even(7);
  even.v_world_ = Vec3(5, 0, 0);
  even.go(3, Vec3::Zero(), Vec3::Zero());
  EXPECT_FALSE(even.now().known) << "who flies evenly and is not shaken reads the same";
  // A first view that is renewed again and again shows no motion in the picture after it.
  for (int k = 0; k < 60; ++k) {
    even.rest_.picture(even.t_ns_, k % 2 > 0 ? 1e-3 : 0);
    even.go(0.05, Vec3::Zero(), Vec3::Zero());
  }
  EXPECT_FALSE(even.now().known);
  Sensor moved(8);
  moved.stand(0.6);
  moved.rest_.picture(moved.t_ns_, 0);
  moved.go(0.5, Vec3::Zero(), Vec3::Zero());
  moved.go(0.5, Vec3::Zero(), Vec3(1, 0, 0));
  EXPECT_FALSE(moved.now().known) << "the pictures moved half a second before it ended";
  Sensor pushed(9);
  pushed.stand(2);
  EXPECT_GT(pushed.now().velocity_sigma, 0);
  pushed.accel_ends_ = true;
  pushed.go(0.02, Vec3::Zero(), Vec3(0, 0, 150));
  EXPECT_EQ(pushed.now().velocity_sigma, 0) << "nobody knows how hard";
}

// Seconds after a take-off a steady push reads as a rest whose vertical leans, and an even cruise as one of no
// velocity.
TEST(RestVertical, ARestThatPicturesShowIsNotGivenUpForOneThatTheyDont) {
  Sensor s(10);
  s.stand(2);
  s.go(3, Vec3::Zero(), Vec3(1.5, 0, 0));
  KnownVertical v = s.now();
  EXPECT_LT(s.off(v), 4 * v.sigma) << "a push of 1.5 m/s^2 leans by 0.15 rad";
  s.go(3, Vec3::Zero(), Vec3::Zero());
  v = s.now();
  ASSERT_GT(v.velocity_sigma, 0);
  EXPECT_LT((s.R_world_body_.transpose() * s.v_world_ - v.velocity).norm(), 4 * v.velocity_sigma);
}

// A window that waits for motion slides, and what is known at its first moment is carried along.
TEST(RestVertical, WhatIsCarriedFromMomentToMomentBecomesLessSure) {
  double nees = 0;
  for (unsigned seed = 1; seed <= 20; ++seed) {
    Sensor s(seed);
    s.stand(2);
    KnownVertical v = s.now();
    for (int k = 0; k < 400; ++k) {
      const rt::TimeNs from_ns = s.t_ns_;
      s.go(0.05, Vec3(0, 0, k < 200 ? 0.5 : 0), Vec3::Zero());
      Preintegration d(ImuBias{v.gyro_bias, Vec3::Zero()});
      s.buffer_.integrate(from_ns, s.t_ns_, s.noise_, &d);
      v.go_on(d);
    }
    nees += std::pow(s.off(v) / v.sigma, 2) / 2;
  }
  EXPECT_LT(nees / 20, 1.5);
}

// Pictures at a height show no motion of a slow drift either.
TEST(RestVertical, WhatPicturesTookForNoMotionMayBeADriftAtAHeight) {
  Sensor s(4);
  s.stand(2);
  KnownVertical v = s.now();
  ASSERT_GT(v.velocity_sigma, 0);
  EXPECT_EQ(v.whole_velocity_sigma(), v.velocity_sigma);
  v.depth_m = 100;
  EXPECT_GT(v.whole_velocity_sigma(), 100 * 1e-3 / 2.1);
  EXPECT_LT(v.whole_velocity_sigma(), 100 * 1e-3);
}

TEST(RestVertical, TurningThereAndBackIsATurnAsWell) {
  Sensor one(2), other(2);
  for (Sensor* s : {&one, &other}) s->stand(2);
  for (int k = 0; k < 4; ++k) {
    one.go(1, Vec3(0, 0, k % 2 > 0 ? 0.6 : -0.6), Vec3::Zero());
    other.go(1, Vec3::Zero(), Vec3::Zero());
  }
  EXPECT_GT(one.now().sigma, 3 * other.now().sigma);
}

TEST(RestVertical, AClockSetBackIsNoEndOfTheRest) {
  Sensor s(6);
  s.t_ns_ = 100 * rt::kNsPerSecond;
  s.stand(2);
  s.t_ns_ = 0;
  s.stand(3);
  EXPECT_GT(s.now().velocity_sigma, 0);
}

TEST(RestVertical, WhoMovesIsNotAtRest) {
  using Motion = std::function<void(Sensor*)>;
  const Motion motions[] = {
      [](Sensor* s) { s->go(3, Vec3::Zero(), Vec3::Zero(), 1.0); },  // shaken three times a second
      [](Sensor* s) { s->go(3, Vec3(0.2, 0, 0), Vec3::Zero()); },    // rolls
      [](Sensor* s) { s->go(3, Vec3(0, 0, 0.5), Vec3::Zero()); },    // spins
      [](Sensor* s) { s->go(3, Vec3::Zero(), -s->R_world_body_.transpose() * Vec3(0, 0, 9.0)); },  // falls
  };
  for (const Motion& motion : motions) {
    Sensor s(3);
    s.shown_ = true;
    motion(&s);
    EXPECT_FALSE(s.now().known) << &motion - motions;
  }
}

TEST(RestVertical, AGapEndsWhatIsKnown) {
  Sensor s(4);
  s.stand(2);
  ASSERT_TRUE(s.now().known);
  s.t_ns_ += 200 * rt::kNsPerMs;
  s.stand(0.1);
  EXPECT_FALSE(s.now().known) << "nobody knows how it turned meanwhile";
}

TEST(RestVertical, WhoIsAtTheEndOfARangeIsNotAtRest) {
  Sensor stuck(5);
  stuck.accel_ends_ = true;
  stuck.go(3, Vec3::Zero(), Vec3::Zero());
  EXPECT_FALSE(stuck.now().known) << "it may be far more than it reads";
  Sensor s(6);
  s.stand(2);
  s.accel_ends_ = true;
  s.go(0.02, Vec3::Zero(), Vec3(0, 0, 150));
  EXPECT_TRUE(s.now().known) << "a push turns nothing";
  s.accel_ends_ = false;
  s.gyro_ends_ = true;
  s.go(0.02, Vec3(0, 0, 5), Vec3::Zero());
  EXPECT_FALSE(s.now().known) << "nobody knows how far it turned";
}

TEST(RestVertical, IsToldOfTheTimeThatIsAskedFor) {
  Sensor s(5);
  s.stand(2);
  s.go(0.5, Vec3(0, 0.6, 0), Vec3(1, 0, 0));
  const rt::TimeNs then_ns = s.t_ns_;
  const Mat3 R_then = s.R_world_body_;
  s.go(0.5, Vec3(0.6, 0, 0), Vec3(1, 0, 0));
  const KnownVertical then = s.rest_.at(then_ns, s.buffer_), now = s.now();
  s.R_world_body_ = R_then;
  EXPECT_LT(s.off(then), 3 * then.sigma);
  EXPECT_GT(s.off(now), 0.1);
  KnownVertical on = then;
  Preintegration d(ImuBias{then.gyro_bias, Vec3::Zero()});
  s.buffer_.integrate(then_ns, s.t_ns_, s.noise_, &d);
  on.go_on(d);
  EXPECT_LT((on.up - now.up).norm() + (on.by_bias - now.by_bias).norm(), 1e-3);
}

}  // namespace rest_vertical_test
}  // namespace godwit::vo
