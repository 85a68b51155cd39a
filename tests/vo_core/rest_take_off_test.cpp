// What a map that begins in motion makes of a rest before it.
#include <Eigen/Cholesky>
#include <cmath>
#include <gtest/gtest.h>

#include "tests/vo_core/inertial_flown.h"
#include "vo_core/inertial/rest_vertical.h"

namespace godwit::vo {
namespace rest_take_off_test {

using test::Flight;
using test::Flown;

/// A vehicle that stands for two seconds and takes off; its map begins on the climb, 0.3 s later.
struct TakeOff {
  explicit TakeOff(unsigned seed) : flight_(3.0, seed), flown_(&flight_, true) { flight_.rests_until_ = 2; }
  MetricPose frame(int k) {
    flown_.tracked_ = k >= kMapFrom;
    flown_.still_ = k < 41;
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
TEST(RestTakeOff, AMapThatBeginsOnATakeOffHasTheVerticalThatItStoodWith) {
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
TEST(RestTakeOff, AMapThatTurnsAsAWholeIsLevelledAsVisionSeesTheCamera) {
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
TEST(RestTakeOff, AMapThatBeginsOnASteadyWayHasTheScaleOfHowFastItBecame) {
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
TEST(RestTakeOff, AMapThatContradictsItBeginsWithoutIt) {
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

// A calm hover: 0.15 m/s^2 to and fro read as one rest after another, and the vertical of the last was 20 mrad off and
// told to 1.6. Maps that began with it had twice the scale.
TEST(RestTakeOff, AnUnshownRestInAHoverTeachesAMapNothing) {
  int begun = 0;
  for (unsigned seed = 1101; seed <= 1104; ++seed) {
    Flight flight(0, seed);
    flight.stops_at_ = 2;
    flight.sways_ = 0.15;
    Flown flown(&flight, true);
    for (int k = 0; k < 680; ++k) {
      flown.tracked_ = k >= 600;
      const MetricPose pose = flown.frame(k);
      if (!pose.valid) continue;
      const double off = flown.odometry_->smoother().newest().log_scale - std::log(flight.scale_);
      EXPECT_LT(std::abs(off), 4 * pose.log_scale_sigma) << seed << ", " << k;
      ++begun;
    }
  }
  EXPECT_GT(begun, 0);
}

}  // namespace rest_take_off_test
}  // namespace godwit::vo
