// The inertial sensor's faults, each alone against the truth of the trajectory; the barometer, and an autopilot's
// attitude.
#include <Eigen/Geometry>
#include <cmath>
#include <gtest/gtest.h>
#include <numbers>
#include <vector>

#include "hal/sim/flight/sim_attitude.h"
#include "hal/sim/flight/sim_baro.h"
#include "hal/sim/sensors/sim_imu.h"
#include "tests/sim/test_scenario.h"

namespace godwit::sim {
namespace {

Trajectory flight(const Vibration& vibration = {}) {
  TrajectoryPlan plan;
  plan.start_height_m = 8;
  plan.vibration = vibration;
  Leg path;
  path.kind = LegKind::kPath;
  path.speed_m_s = 5;
  path.points_m = {{40, 0}, {40, 30}, {0, 30}, {0, 0}, {40, 0}};
  plan.legs = {path};
  return Trajectory(plan, 0, 11);
}

/// No noise, no bias: what is left is the fault.
ImuModel clean() {
  ImuModel m;
  m.gyro_noise = m.accel_noise = m.gyro_bias_walk = m.accel_bias_walk = m.gyro_bias = m.accel_bias = 0;
  m.quantise = false;
  return m;
}

std::vector<hal::ImuSample> all(SimImu* imu) {
  std::vector<hal::ImuSample> out;
  hal::ImuSample s;
  while (imu->next(&s, 0) == hal::ImuStatus::kSample) out.push_back(s);
  return out;
}

Vec3 gyro_of(const hal::ImuSample& s) {
  return Vec3(s.gyro_rad_s[0], s.gyro_rad_s[1], s.gyro_rad_s[2]);
}
Vec3 accel_of(const hal::ImuSample& s) {
  return Vec3(s.accel_m_s2[0], s.accel_m_s2[1], s.accel_m_s2[2]);
}

TEST(SimImuFaults, TheLowPassIsLateByItsDelay) {
  const Trajectory trajectory = flight();
  ImuModel model = clean();
  model.delay_ms = 3;
  SimImu imu(trajectory, model, 0, 1);
  const std::vector<hal::ImuSample> samples = all(&imu);
  ASSERT_GT(samples.size(), 4000u);
  const auto misfit = [&](double late_s) {
    double sum = 0;
    for (std::size_t i = 200; i < samples.size(); ++i) {
      sum += (accel_of(samples[i]) - trajectory.at(rt::to_seconds(samples[i].t_ns) - late_s).specific_force_m_s2)
                 .squaredNorm();
    }
    return std::sqrt(sum / static_cast<double>(samples.size()));
  };
  EXPECT_LT(misfit(3e-3), 0.2 * misfit(0));
  EXPECT_LT(misfit(3e-3), misfit(2.8e-3));
  EXPECT_LT(misfit(3e-3), misfit(3.2e-3));
}

TEST(SimImuFaults, JitterMovesTheTimesToldAndKeepsTheirOrder) {
  const Trajectory trajectory = flight();
  ImuModel model = clean();
  SimImu steady(trajectory, model, 1000, 1);
  model.clock_jitter_ms = 0.5;
  SimImu shaky(trajectory, model, 1000, 1);
  const std::vector<hal::ImuSample> a = all(&steady), b = all(&shaky);
  ASSERT_EQ(a.size(), b.size());
  double sum = 0;
  for (std::size_t i = 1; i < a.size(); ++i) {
    EXPECT_GT(b[i].t_ns, b[i - 1].t_ns);
    EXPECT_EQ(a[i].accel_m_s2, b[i].accel_m_s2) << "it measures when it did";
    sum += std::pow(rt::to_seconds(b[i].t_ns - a[i].t_ns), 2);
  }
  EXPECT_NEAR(std::sqrt(sum / static_cast<double>(a.size())), 0.5e-3, 0.05e-3);
}

TEST(SimImuFaults, ACrookedSensorReadsTurnedAxes) {
  const Trajectory trajectory = flight();
  ImuModel model = clean();
  model.mounting_error_deg = 1.5;
  SimImu imu(trajectory, model, 0, 3), other(trajectory, model, 0, 4);
  const Eigen::AngleAxisd turn(imu.R_sensor_body());
  EXPECT_NEAR(turn.angle() * 180 / std::numbers::pi, 1.5, 1e-9);
  EXPECT_GT((turn.axis() - Eigen::AngleAxisd(other.R_sensor_body()).axis()).norm(), 0.1) << "drawn by seed";
  for (const hal::ImuSample& s : all(&imu)) {
    const BodyState truth = trajectory.at(rt::to_seconds(s.t_ns));
    EXPECT_LT((turn.toRotationMatrix() * truth.omega_rad_s - gyro_of(s)).norm(), 1e-9);
    EXPECT_LT((turn.toRotationMatrix() * truth.specific_force_m_s2 - accel_of(s)).norm(), 1e-9);
  }
}

TEST(SimImuFaults, BiasesRampAsLongAsItFlies) {
  const Trajectory trajectory = flight();
  ImuModel model = clean();
  model.gyro_bias_ramp = 1e-3;
  model.accel_bias_ramp = 1e-2;
  double gyro2 = 0, accel2 = 0;
  constexpr int kSeeds = 60;
  for (std::uint64_t seed = 1; seed <= kSeeds; ++seed) {
    SimImu imu(trajectory, model, 0, seed);
    hal::ImuSample s;
    while (imu.next(&s, 0) == hal::ImuStatus::kSample && s.t_ns < 2 * rt::kNsPerSecond) {
    }
    const BodyState truth = trajectory.at(rt::to_seconds(s.t_ns));
    EXPECT_LT((gyro_of(s) - truth.omega_rad_s - imu.truth().gyro_bias_rad_s).norm(), 1e-9);
    gyro2 += imu.truth().gyro_bias_rad_s.squaredNorm() / 3;
    accel2 += imu.truth().accel_bias_m_s2.squaredNorm() / 3;
  }
  EXPECT_NEAR(std::sqrt(gyro2 / kSeeds), 2e-3, 0.3e-3);
  EXPECT_NEAR(std::sqrt(accel2 / kSeeds), 2e-2, 0.3e-2);
}

TEST(SimImuFaults, ShakingBeyondTheRangeLeavesABias) {
  // 85 Hz of 1 mm is 285 m/s^2; what is cut off is more on the side on which gravity lies, and the low-pass hides it.
  Vibration shake;
  shake.frequency_hz = 85;
  shake.position_mm = 1;
  const Trajectory trajectory = flight(shake), calm = flight();
  ImuModel model = clean();
  model.delay_ms = 3;
  const auto mean_error = [&](double range) {
    model.accel_range_m_s2 = range;
    SimImu imu(trajectory, model, 0, 1);
    Vec3 sum = Vec3::Zero();
    const std::vector<hal::ImuSample> samples = all(&imu);
    for (const hal::ImuSample& s : samples) {
      sum += accel_of(s) - calm.at(rt::to_seconds(s.t_ns) - 3e-3).specific_force_m_s2;
    }
    return Vec3(sum / static_cast<double>(samples.size()));
  };
  EXPECT_LT(mean_error(1e4).norm(), 0.3);
  EXPECT_GT(mean_error(80).norm(), 1.0);
}

TEST(SimImuFaults, TheUsualFaultsAreAllThere) {
  const ImuModel model, faulty = with_usual_faults(model);
  EXPECT_DOUBLE_EQ(faulty.noise_times, 2);
  EXPECT_DOUBLE_EQ(faulty.gyro_noise, model.gyro_noise) << "what is told of it stays the data sheet's";
  EXPECT_GT(faulty.delay_ms * faulty.clock_jitter_ms * faulty.mounting_error_deg * faulty.gyro_bias_ramp *
                faulty.accel_bias_ramp,
            0);
}

TEST(SimBarometer, TellsHeightsWithTheErrorsOfItsPlan) {
  Scenario scenario = test::scenario("take-off-and-land");
  scenario.baro.noise_pa = 1.2;
  scenario.baro.wander_pa = 0;
  scenario.baro.dynamic_share = 0;
  const Flight flight(scenario, 1);
  const auto baro = flight.barometer(7000);
  hal::BaroSample s;
  double sum = 0;
  int n = 0;
  ASSERT_NE(baro, nullptr);
  while (baro->next(&s, 0) == hal::BaroStatus::kSample) {
    const double z = flight.trajectory().at(rt::to_seconds(s.t_ns - 7000)).position_m.z();
    EXPECT_NEAR(baro->truth_pa(), standard_pressure_pa(z), 1e-6);
    sum += std::pow(s.pressure_pa - baro->truth_pa(), 2);
    ++n;
  }
  EXPECT_EQ(n, static_cast<int>(flight.duration_s() * scenario.baro.rate_hz) + 1);
  EXPECT_NEAR(std::sqrt(sum / n), 1.2, 0.1);
  // Near the sea 12 Pa are a metre.
  EXPECT_NEAR(standard_pressure_pa(0) - standard_pressure_pa(1), 12.0, 0.1);
  scenario.baro.present = false;
  EXPECT_EQ(Flight(scenario, 1).barometer(0), nullptr);
}

TEST(SimAttitude, LeansSlowlyAsItsPlanSays) {
  Scenario scenario = test::scenario("take-off-and-land");
  scenario.attitude.noise_deg = 0;
  scenario.attitude.wander_deg = 2;
  scenario.attitude.wander_s = 2;
  const Flight flight(scenario, 1);
  SimAttitude attitude(flight, 7000), again(flight, 7000);
  AttitudeSample s, same;
  double squared = 0, last = 0;
  int n = 0;
  for (; attitude.next(&s); ++n) {
    ASSERT_TRUE(again.next(&same));
    EXPECT_EQ(s.q_ned_body, same.q_ned_body);
    const double t = rt::to_seconds(s.t_ns - 7000);
    const auto& q = s.q_ned_body;
    const Mat3 R = Eigen::Quaterniond(q[0], q[1], q[2], q[3]).toRotationMatrix();
    const Vec3 down = R.row(2), true_down = -flight.trajectory().at(t).R_world_body.row(2);
    const double off = std::atan2(down.cross(true_down).norm(), down.dot(true_down)) * 180 / std::numbers::pi;
    EXPECT_NEAR(off, attitude.off_deg(), 1e-3);
    if (n > 0) {
      EXPECT_LT(std::abs(off - last), 5 * 2 * std::sqrt(2 * 0.1 / 2)) << "it does not jump";
    }
    last = off;
    squared += off * off / 2;  // roll and pitch
  }
  EXPECT_EQ(n, static_cast<int>(flight.duration_s() * scenario.attitude.rate_hz) + 1);
  EXPECT_NEAR(std::sqrt(squared / n), 2, 0.7);
}

TEST(SimBarometer, SeesSpeedWeatherAndLagWhereItsPlanSaysSo) {
  Scenario scenario = test::scenario("street");
  scenario.baro.noise_pa = scenario.baro.wander_pa = 0;
  scenario.baro.dynamic_share = 0.5;
  const Flight flight(scenario, 1);
  const auto baro = flight.barometer(0);
  hal::BaroSample s;
  double worst = 0;
  while (baro->next(&s, 0) == hal::BaroStatus::kSample) {
    const double v = flight.trajectory().at(rt::to_seconds(s.t_ns)).velocity_m_s.norm();
    EXPECT_NEAR(baro->truth_pa() - s.pressure_pa, 0.5 * 0.5 * 1.225 * v * v, 1e-6);
    worst = std::max(worst, baro->truth_pa() - s.pressure_pa);
  }
  EXPECT_GT(worst, 2.0);
  // The weather: two sensors of the same plan and another seed differ by its sigma.
  scenario.baro.dynamic_share = 0;
  scenario.baro.wander_pa = 20;
  scenario.world.ground_texels = 512;
  double sum = 0;
  for (std::uint64_t seed = 1; seed <= 12; ++seed) {
    const Flight other(scenario, seed);
    const auto b = other.barometer(0);
    ASSERT_EQ(b->next(&s, 0), hal::BaroStatus::kSample);
    sum += std::pow(s.pressure_pa - b->truth_pa(), 2) / 12;
  }
  EXPECT_GT(std::sqrt(sum), 8);
  EXPECT_LT(std::sqrt(sum), 40);
}

}  // namespace
}  // namespace godwit::sim
