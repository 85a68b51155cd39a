// The vertical of a sensor that rests: when it is one, how far the gyroscope carries it, and what a map that begins in
// motion makes of it.
#include "vo_core/inertial/rest_vertical.h"

#include <Eigen/Cholesky>
#include <cmath>
#include <functional>
#include <gtest/gtest.h>
#include <random>

#include "tests/vo_core/inertial_flown.h"

namespace godwit::vo {
namespace rest_vertical_test {

using test::Flight;
using test::Flown;

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
      v_world_ += 0.005 * (R_world_body_ * so3_exp(0.0025 * rate) * acceleration);
      R_world_body_ = R_world_body_ * so3_exp(0.005 * rate);
    }
  }
  /// As long on the ground, before pictures that show it.
  void stand(double seconds) {
    for (int k = 0; k < std::lround(seconds * 20); ++k) {
      rest_.picture(t_ns_, true);
      go(0.05, Vec3::Zero(), Vec3::Zero());
    }
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
  ImuBuffer buffer_;
  RestVertical rest_{noise_, kStandardGravity, 0.1};
  Mat3 R_world_body_ = so3_exp(Vec3(0.3, -0.2, 1));
  Vec3 v_world_ = Vec3::Zero();
  rt::TimeNs t_ns_ = 0;
};

TEST(RestVertical, IsKnownAfterASecondAtRest) {
  Sensor s(1);
  s.go(0.9, Vec3::Zero(), Vec3::Zero());
  EXPECT_FALSE(s.now().known);
  s.go(0.3, Vec3::Zero(), Vec3::Zero());
  ASSERT_TRUE(s.now().known);
  EXPECT_LT(s.off(s.now()), 3 * s.now().sigma);
  EXPECT_LT(s.now().sigma, 3e-3);
}

TEST(RestVertical, IsCarriedByTheGyroscopeWhereItIsTurnedAndPushed) {
  double nees = 0;
  for (unsigned seed = 1; seed <= 20; ++seed) {
    Sensor s(seed);
    s.go(2, Vec3::Zero(), Vec3::Zero());
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
    EXPECT_LT(v.velocity_sigma, 0.2) << "of 2 m/s, after a turn by half a radian";
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
    EXPECT_NEAR(on.velocity_sigma, v.velocity_sigma, 0.2 * v.velocity_sigma);
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

TEST(RestVertical, OnlyOfARestThatPicturesShowIsTheVelocityKnown) {
  Sensor even(7);
  even.v_world_ = Vec3(5, 0, 0);
  even.go(3, Vec3::Zero(), Vec3::Zero());
  EXPECT_TRUE(even.now().known) << "who flies evenly and is not shaken reads the same";
  EXPECT_EQ(even.now().velocity_sigma, 0);
  // A first view that is renewed again and again shows no motion in the picture after it.
  for (int k = 0; k < 60; ++k) {
    even.rest_.picture(even.t_ns_, k % 2 > 0);
    even.go(0.05, Vec3::Zero(), Vec3::Zero());
  }
  EXPECT_EQ(even.now().velocity_sigma, 0);
  Sensor moved(8);
  moved.stand(0.6);
  moved.rest_.picture(moved.t_ns_, false);
  moved.go(0.5, Vec3::Zero(), Vec3::Zero());
  moved.go(0.5, Vec3::Zero(), Vec3(1, 0, 0));
  EXPECT_TRUE(moved.now().known);
  EXPECT_EQ(moved.now().velocity_sigma, 0) << "the pictures moved half a second before it ended";
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
  // What is known of it has grown old: then the next is taken, and nothing known of how fast one is.
  s.go(6, Vec3::Zero(), Vec3::Zero());
  EXPECT_TRUE(s.now().known);
  EXPECT_EQ(s.now().velocity_sigma, 0);
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
    motion(&s);
    EXPECT_FALSE(s.now().known) << &motion - motions;
  }
}

TEST(RestVertical, AGapEndsWhatIsKnown) {
  Sensor s(4);
  s.go(2, Vec3::Zero(), Vec3::Zero());
  ASSERT_TRUE(s.now().known);
  s.t_ns_ += 200 * rt::kNsPerMs;
  s.go(0.1, Vec3::Zero(), Vec3::Zero());
  EXPECT_FALSE(s.now().known) << "nobody knows how it turned meanwhile";
}

TEST(RestVertical, WhoIsAtTheEndOfARangeIsNotAtRest) {
  Sensor stuck(5);
  stuck.accel_ends_ = true;
  stuck.go(3, Vec3::Zero(), Vec3::Zero());
  EXPECT_FALSE(stuck.now().known) << "it may be far more than it reads";
  Sensor s(6);
  s.go(2, Vec3::Zero(), Vec3::Zero());
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
  s.go(2, Vec3::Zero(), Vec3::Zero());
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

/// A vehicle that stands for two seconds and takes off; its map begins on the climb, 0.3 s later.
struct TakeOff {
  explicit TakeOff(unsigned seed) : flight_(3.0, seed), flown_(&flight_, true) { flight_.rests_until_ = 2; }
  MetricPose frame(int k) {
    flown_.tracked_ = k >= kMapFrom;
    return flown_.frame(k);
  }
  Mat3 R_camera(int k) const { return flight_.R(k / 20.0) * flight_.mounting_.R_body_cam; }
  /// Between the vertical along the camera's axes as it is and as it is told [rad].
  double tilt(int k, const MetricPose& pose) const {
    return angle_between(pose.T_nav_cam.R.transpose() * Vec3::UnitZ(), R_camera(k).transpose() * Vec3::UnitZ());
  }

  static constexpr int kMapFrom = 46;
  Flight flight_;
  Flown flown_;
};

// A vehicle that stands, takes off, and whose map begins on the climb: a map a second old shows motion askew (by 0.3
// rad in simulated take-offs), and the vertical that its accelerations had to explain alone was off by 3 to 5 degrees,
// eight times the variance that was told.
TEST(RestVertical, AMapThatBeginsOnATakeOffHasTheVerticalThatItStoodWith) {
  double nees = 0, tilt = 0;
  int told = 0;
  for (unsigned seed = 1; seed <= 12; ++seed) {
    TakeOff off_ground(900 + seed);
    off_ground.flown_.lean_ = 0.3;
    int first = -1;
    for (int k = 0; k < 160 && (first < 0 || k < first + 40); ++k) {
      const MetricPose pose = off_ground.frame(k);
      if (!pose.valid) continue;
      if (first < 0) first = k;
      const Vec3 off = pose.T_nav_cam.R * off_ground.R_camera(k).transpose() * Vec3::UnitZ();
      const Eigen::Vector2d e(-off.y(), off.x());
      nees += e.dot(pose.covariance.block<2, 2>(3, 3).llt().solve(e)) / 2;
      tilt += e.norm();
      ++told;
    }
    EXPECT_GE(first, 0) << seed;
  }
  ASSERT_EQ(told, 12 * 40);
  EXPECT_LT(nees / told, 2.0);
  EXPECT_LT(tilt / told, 0.025);
}

// A map of a take-off turns by 60 mrad in the second and a half after it has begun, and the way flown in it along with
// it. Levelled by the window's vertical along the map's axes, beside attitudes as vision sees them, those leant by 18
// mrad.
TEST(RestVertical, AMapThatTurnsAsAWholeIsLevelledAsVisionSeesTheCamera) {
  double error2 = 0, tilt = 0, nees = 0;
  int told = 0;
  for (unsigned seed = 1; seed <= 12; ++seed) {
    TakeOff off_ground(950 + seed);
    Flown& flown = off_ground.flown_;
    flown.turns_ = 0.06;
    for (int k = 0; k < 160; ++k) {
      const MetricPose pose = off_ground.frame(k);
      if (!pose.valid) continue;
      const Vec3 e = flown.place_error(k, pose);
      // From when the map no longer turns.
      if (k < TakeOff::kMapFrom + 30 || k == flown.begun_) continue;
      tilt += off_ground.tilt(k, pose);
      error2 += e.squaredNorm();
      nees += e.dot(pose.covariance.topLeftCorner<3, 3>().llt().solve(e)) / 3;
      ++told;
    }
    EXPECT_GE(flown.begun_, 0) << seed;
  }
  ASSERT_GT(told, 12 * 60);
  EXPECT_LT(tilt / told, 0.015);
  EXPECT_LT(std::sqrt(error2 / told), 0.05);
  EXPECT_LT(nees / told, 2.0);
}

// Four seconds after it stood it goes evenly, and only then its map begins: nothing of that shows a scale.
TEST(RestVertical, AMapThatBeginsOnASteadyWayHasTheScaleOfHowFastItBecame) {
  for (const bool still : {true, false}) {
    double off2 = 0, nees = 0;
    int begun = 0;
    for (unsigned seed = 1; seed <= 12; ++seed) {
      Flight flight(0, 1100 + seed);
      flight.stops_at_ = 2;
      flight.cruises_ = 2;
      Flown flown(&flight, true);
      for (int k = 0; k < 140; ++k) {
        flown.tracked_ = k >= 85;
        flown.still_ = still && k < 46;
        const MetricPose pose = flown.frame(k);
        if (!pose.valid) continue;
        const double off = flown.odometry_->smoother().newest().log_scale - std::log(flight.scale_);
        off2 += off * off;
        nees += off * off / (pose.log_scale_sigma * pose.log_scale_sigma);
        ++begun;
        break;
      }
    }
    if (!still) {
      EXPECT_EQ(begun, 0) << "a way that nobody saw begin has no scale, and none is told";
      continue;
    }
    ASSERT_EQ(begun, 12);
    EXPECT_LT(std::sqrt(off2 / 12), 0.06);
    EXPECT_LT(nees / 12, 2.0);
  }
}

// It may not have been a rest: on a ship's deck that gathers way a sensor reads a steady force that is not gravity
// alone.
TEST(RestVertical, AMapThatContradictsItBeginsWithoutIt) {
  TakeOff off_ground(990);
  Vec3& read = off_ground.flight_.bias_.accel;
  const Vec3 bias = read;
  double tilt = 0;
  int told = 0;
  for (int k = 0; k < 160; ++k) {
    read = k < 44 ? Vec3(bias + Vec3(0, 3, 0)) : bias;
    const MetricPose pose = off_ground.frame(k);
    if (!pose.valid || k < 120) continue;
    tilt += off_ground.tilt(k, pose);
    ++told;
  }
  ASSERT_EQ(told, 40);
  EXPECT_LT(tilt / told, 0.02);
}

}  // namespace rest_vertical_test
}  // namespace godwit::vo
