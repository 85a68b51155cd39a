// Turns as vision sees them and readings as a gyroscope gives them, of one made-up flight: what lies between the two
// must be found.
#include "firmware_app/calibration/camera_imu.h"

#include <cmath>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <random>

#include "vo_core/geometry/geometry.h"

namespace godwit::app {
namespace camera_imu_test {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using testing::HasSubstr;

/// The body's attitude at a time [s]. axes: about how many it turns.
Matrix3d attitude(double t, int axes) {
  return vo::so3_exp({0.5 * std::sin(1.3 * t), axes > 1 ? 0.4 * std::sin(1.9 * t + 1) : 0, 0}) *
         vo::so3_exp({0, 0, axes > 2 ? 0.6 * std::sin(0.8 * t) : 0});
}

struct Flown {
  Matrix3d R_body_cam = vo::so3_exp({0.7, -1.9, 0.8});
  double time_offset_s = 0;
  Vector3d bias{0.01, -0.02, 0.005};
  int axes = 3;
  unsigned seed = 3;
  std::vector<SeenTurn> turns;
  std::vector<hal::ImuSample> readings;

  void fly(double seconds) {
    std::mt19937_64 random(seed);
    std::normal_distribution<double> normal;
    constexpr double kStep = 0.005;
    for (int i = 0; i < static_cast<int>(seconds / kStep); ++i) {
      const double t = i * kStep;
      const Vector3d rate = vo::so3_log(attitude(t - 1e-4, axes).transpose() * attitude(t + 1e-4, axes)) / 2e-4 + bias;
      hal::ImuSample s;
      s.t_ns = static_cast<rt::TimeNs>(std::llround(t * 1e9));
      for (int a = 0; a < 3; ++a) s.gyro_rad_s[static_cast<std::size_t>(a)] = rate[a] + 2e-3 * normal(random);
      readings.push_back(s);
    }
    const auto seen = [&](double t) -> Matrix3d {
      const Vector3d noise(normal(random), normal(random), normal(random));
      return attitude(t, axes) * R_body_cam * vo::so3_exp(3e-4 * noise);
    };
    Matrix3d last = seen(0.5);
    for (int k = 1; 0.5 + k / 20.0 < seconds - 0.5; ++k) {
      const double t = 0.5 + k / 20.0;
      const Matrix3d now = seen(t);
      turns.push_back({static_cast<rt::TimeNs>(std::llround((t - 0.05 - time_offset_s) * 1e9)),
                       static_cast<rt::TimeNs>(std::llround((t - time_offset_s) * 1e9)), last.transpose() * now});
      last = now;
    }
  }
};

TEST(CameraImu, RotationAndTimeAreFoundWithoutAGuess) {
  for (const double offset : {0.0, -0.0237, 0.0862}) {
    Flown f;
    f.time_offset_s = offset;
    f.fly(20);
    // Vision is wrong at times.
    for (std::size_t i = 7; i < f.turns.size(); i += 40) f.turns[i].R_from_to *= vo::so3_exp({0.05, -0.02, 0.03});
    const auto fit = fit_camera_imu(f.turns, f.readings);
    ASSERT_TRUE(fit.ok()) << fit.error().message;
    EXPECT_NEAR(fit.value().time_offset_s, offset, 5e-4);
    EXPECT_LT(vo::so3_log(f.R_body_cam.transpose() * fit.value().R_body_cam).norm(), 2e-3);
    EXPECT_LT((fit.value().gyro_bias_rad_s - f.bias).norm(), 1e-3);
    EXPECT_LT(fit.value().time_sigma_s, 5e-4);
    EXPECT_LT(fit.value().turn_sigma_rad, 2e-3);
    EXPECT_GE(fit.value().turns_left_out, f.turns.size() / 40);
  }
}

/// Turns as `godwit replay` gathers them: 30 pictures a second, each against the one four before it. Vision's error is
/// one of each picture, and a walk since neighbours show the same map points; both are larger where the camera turns
/// faster. noise, walk: one sigma an axis, of a picture, at 1 rad/s.
Flown as_replayed(unsigned seed, double noise, double walk) {
  Flown f;
  f.seed = seed;
  f.fly(14);
  f.turns.clear();
  std::mt19937_64 random(seed + 100);
  std::normal_distribution<double> normal;
  const auto draw = [&] { return Vector3d(normal(random), normal(random), normal(random)); };
  Vector3d strayed = Vector3d::Zero();
  std::vector<std::pair<rt::TimeNs, Matrix3d>> seen;
  for (double t = 0.5; t < 13.5; t += 1 / 30.0) {
    const double rate = vo::so3_log(attitude(t - 1e-3, 3).transpose() * attitude(t + 1e-3, 3)).norm() / 2e-3;
    strayed += walk * rate * draw();
    seen.emplace_back(std::llround(t * 1e9),
                      vo::so3_exp(strayed + noise * rate * draw()) * attitude(t, 3) * f.R_body_cam);
    if (seen.size() < 5) continue;
    const auto& [from_ns, from] = seen[seen.size() - 5];
    f.turns.push_back({from_ns, seen.back().first, from.transpose() * seen.back().second});
  }
  return f;
}

// Taken as independent the turns told a sigma of 0.2 ms, and the estimates of twenty rendered flights scattered by
// 0.55.
TEST(CameraImu, TheSigmasToldAreThoseOfTheScatterWhereNeighbouringTurnsErrTogether) {
  constexpr double kError = 5e-4;
  // A walk, and the mixture whose neighbours are as alike as those of the rendered flights: 0.4.
  for (const double noise : {0.0, 1.2 * kError}) {
    double time2 = 0, told_time2 = 0, turn2 = 0, told_turn2 = 0;
    constexpr unsigned kFlights = 24;
    for (unsigned seed = 1; seed <= kFlights; ++seed) {
      const Flown f = as_replayed(seed, noise, kError);
      const auto fit = fit_camera_imu(f.turns, f.readings);
      ASSERT_TRUE(fit.ok()) << fit.error().message;
      const Vector3d off = vo::so3_log(f.R_body_cam.transpose() * fit.value().R_body_cam);
      time2 += fit.value().time_offset_s * fit.value().time_offset_s / kFlights;
      told_time2 += fit.value().time_sigma_s * fit.value().time_sigma_s / kFlights;
      turn2 += off.cwiseAbs2().maxCoeff() / kFlights;
      told_turn2 += fit.value().turn_sigma_rad * fit.value().turn_sigma_rad / kFlights;
    }
    std::printf("offset %.2f ms, told %.2f; rotation %.2f mrad, told %.2f\n", 1e3 * std::sqrt(time2),
                1e3 * std::sqrt(told_time2), 1e3 * std::sqrt(turn2), 1e3 * std::sqrt(told_turn2));
    EXPECT_LT(time2, 1.5 * 1.5 * told_time2);
    EXPECT_GT(time2, told_time2 / (1.5 * 1.5));
    // The worst axis of three.
    EXPECT_LT(turn2, 1.5 * 1.5 * told_turn2);
    EXPECT_GT(turn2, told_turn2 / (1.5 * 1.5));
  }
}

TEST(CameraImu, WhatCannotShowItIsRefusedInWords) {
  const auto told = [](const Flown& f) {
    const auto fit = fit_camera_imu(f.turns, f.readings);
    return fit.ok() ? std::string("taken") : fit.error().message;
  };
  Flown one_axis;
  one_axis.axes = 1;
  one_axis.fly(20);
  EXPECT_THAT(told(one_axis), HasSubstr("turn it about all three"));
  Flown brief;
  brief.fly(3);
  EXPECT_THAT(told(brief), HasSubstr("60 at least are needed"));
  Flown flown;
  flown.fly(20);
  Flown others = flown;
  for (SeenTurn& t : others.turns) {
    t.t_from_ns += 3 * rt::kNsPerSecond;
    t.t_to_ns += 3 * rt::kNsPerSecond;
  }
  EXPECT_THAT(told(others), HasSubstr("not those that vision saw"));
  Flown unread = flown;
  unread.readings.clear();
  EXPECT_THAT(told(unread), HasSubstr("do not cover"));
}

}  // namespace camera_imu_test
}  // namespace godwit::app
