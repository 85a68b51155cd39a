#include "hal/sim/sensors/sim_imu.h"

#include <Eigen/Geometry>
#include <cmath>
#include <gtest/gtest.h>
#include <tuple>
#include <vector>

namespace godwit::sim {
namespace {

Trajectory round_flight() {
  TrajectoryPlan plan;
  plan.start_height_m = 8;
  Leg path;
  path.kind = LegKind::kPath;
  path.speed_m_s = 5;
  path.points_m = {{40, 0}, {40, 30}, {0, 30}, {0, 0}, {40, 0}, {40, 30}, {0, 30}};
  plan.legs = {path};
  return Trajectory(plan, 0, 11);
}

struct State {
  Mat3 R;
  Vec3 v, p;
};

/// One step with the mean of the readings at both ends (trapezoid rule on rates and on turned forces).
void integrate(State* s, const Vec3& w0, const Vec3& f0, const Vec3& w1, const Vec3& f1, double dt) {
  const Vec3 turn = 0.5 * (w0 + w1) * dt;
  const Mat3 next = turn.norm() > 0 ? Mat3(s->R * Eigen::AngleAxisd(turn.norm(), turn.normalized())) : s->R;
  const Vec3 a0 = s->R * f0 - Vec3(0, 0, kGravity), a1 = next * f1 - Vec3(0, 0, kGravity);
  s->p += s->v * dt + (a0 / 3 + a1 / 6) * dt * dt;
  s->v += 0.5 * (a0 + a1) * dt;
  s->R = next;
}

TEST(SimImu, AnIdealSensorIntegratesToTheTrajectory) {
  const Trajectory trajectory = round_flight();
  ImuModel ideal;
  ideal.rate_hz = 1000;
  ideal.gyro_noise = ideal.accel_noise = ideal.gyro_bias_walk = ideal.accel_bias_walk = ideal.gyro_bias =
      ideal.accel_bias = 0;
  ideal.quantise = false;
  SimImu imu(trajectory, ideal, 0, 1);
  const BodyState start = trajectory.at(0);
  State state{start.R_world_body, start.velocity_m_s, start.position_m};
  hal::ImuSample sample;
  Vec3 w0, f0;
  double t = 0;
  for (int i = 0; imu.next(&sample, 0) == hal::ImuStatus::kSample; ++i) {
    const Vec3 w(sample.gyro_rad_s[0], sample.gyro_rad_s[1], sample.gyro_rad_s[2]);
    const Vec3 f(sample.accel_m_s2[0], sample.accel_m_s2[1], sample.accel_m_s2[2]);
    if (i > 0) integrate(&state, w0, f0, w, f, 1e-3);
    w0 = w;
    f0 = f;
    t = rt::to_seconds(sample.t_ns);
  }
  ASSERT_GT(t, 30.0);
  const BodyState end = trajectory.at(t);
  EXPECT_LT((state.p - end.position_m).norm(), 0.01) << "over " << t << " s";
  EXPECT_LT((state.v - end.velocity_m_s).norm(), 1e-3);
  EXPECT_LT(Eigen::AngleAxisd(state.R.transpose() * end.R_world_body).angle(), 1e-5);
}

TEST(SimImu, ANoisySensorErrsAsItsDataSheetSays) {
  // Windows of one second from the true state, true bias taken off: what is left must be the white noise integrated.
  const Trajectory trajectory = round_flight();
  const ImuModel model;
  double turn2 = 0, speed2 = 0, place2 = 0;
  int windows = 0;
  for (std::uint64_t seed = 1; seed <= 6; ++seed) {
    SimImu imu(trajectory, model, 0, seed);
    State state{};
    hal::ImuSample sample;
    Vec3 w0, f0;
    const int per_window = static_cast<int>(model.rate_hz);
    for (int i = 0; imu.next(&sample, 0) == hal::ImuStatus::kSample; ++i) {
      const ImuTruth& truth = imu.truth();
      Vec3 w, f;
      for (int k = 0; k < 3; ++k) {
        w[k] = sample.gyro_rad_s[static_cast<std::size_t>(k)] - truth.gyro_bias_rad_s[k];
        f[k] = sample.accel_m_s2[static_cast<std::size_t>(k)] - truth.accel_bias_m_s2[k];
      }
      const double t = i / model.rate_hz;
      if (i % per_window != 0) {
        integrate(&state, w0, f0, w, f, 1 / model.rate_hz);
      } else {
        const BodyState now = trajectory.at(t);
        if (i > 0) {
          integrate(&state, w0, f0, w, f, 1 / model.rate_hz);
          const Eigen::AngleAxisd error(now.R_world_body.transpose() * state.R);
          turn2 += error.angle() * error.angle() / 3;
          speed2 += (state.v - now.velocity_m_s).squaredNorm() / 3;
          place2 += (state.p - now.position_m).squaredNorm() / 3;
          ++windows;
        }
        state = {now.R_world_body, now.velocity_m_s, now.position_m};
      }
      w0 = w;
      f0 = f;
    }
  }
  ASSERT_GT(windows, 150);
  // White noise of density n over T: n sqrt(T) in the first integral, n sqrt(T^3 / 3) in the second. Tilt errors turn
  // gravity: that adds g n_gyro sqrt(T^3 / 3) to two of the three axes of the speed, a twelfth of the accelerometer's
  // part.
  EXPECT_NEAR(std::sqrt(turn2 / windows) / model.gyro_noise, 1.0, 0.15);
  EXPECT_NEAR(std::sqrt(speed2 / windows) / model.accel_noise, 1.0, 0.15);
  EXPECT_NEAR(std::sqrt(place2 / windows) / (model.accel_noise / std::sqrt(3.0)), 1.0, 0.2);
}

TEST(SimImu, SaturatesAndQuantises) {
  TrajectoryPlan plan;
  plan.start_height_m = 5;
  Leg spin;
  spin.kind = LegKind::kSpin;
  spin.angle_deg = 720;
  spin.rate_deg_s = 180;
  plan.legs = {spin};
  const Trajectory trajectory(plan, 0, 1);
  ImuModel model;
  model.gyro_range_rad_s = 1.0;
  SimImu imu(trajectory, model, 5'000, 1);
  hal::ImuSample sample;
  double largest = 0;
  ASSERT_EQ(imu.next(&sample, 0), hal::ImuStatus::kSample);
  EXPECT_EQ(sample.t_ns, 5'000);
  const double lsb = model.accel_range_m_s2 / 32768;
  while (imu.next(&sample, 0) == hal::ImuStatus::kSample) {
    bool at_end = false;
    for (const double g : sample.gyro_rad_s) {
      largest = std::max(largest, std::abs(g));
      at_end |= std::abs(g) > 0.9999;
    }
    EXPECT_EQ(sample.flags, at_end ? hal::kImuGyroSaturated : 0);
    EXPECT_NEAR(std::remainder(sample.accel_m_s2[2], lsb), 0, 1e-9);
  }
  EXPECT_DOUBLE_EQ(largest, 1.0);
}

TEST(SimImu, SameSeedSameSamples) {
  const Trajectory trajectory = round_flight();
  SimImu a(trajectory, {}, 0, 5), b(trajectory, {}, 0, 5), c(trajectory, {}, 0, 6);
  hal::ImuSample x, y, z;
  bool other_differs = false;
  for (int i = 0; i < 2000; ++i) {
    ASSERT_EQ(a.next(&x, 0), b.next(&y, 0));
    ASSERT_EQ(c.next(&z, 0), hal::ImuStatus::kSample);
    ASSERT_EQ(std::tie(x.t_ns, x.gyro_rad_s, x.accel_m_s2, x.flags),
              std::tie(y.t_ns, y.gyro_rad_s, y.accel_m_s2, y.flags));
    other_differs = other_differs || x.accel_m_s2 != z.accel_m_s2;
  }
  EXPECT_TRUE(other_differs);
}

}  // namespace
}  // namespace godwit::sim
