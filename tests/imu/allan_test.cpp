#include "hal/imu/allan.h"

#include <cmath>
#include <gtest/gtest.h>
#include <random>

namespace godwit::hal::allan_test {
namespace {

constexpr double kRateHz = 100;

/// A still sensor: white noise of these densities, and biases that walk.
std::vector<ImuSample> still(double seconds, double gyro_density, double gyro_walk, double accel_density,
                             double accel_walk, unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::vector<ImuSample> out(static_cast<std::size_t>(seconds * kRateHz));
  std::array<double, 6> bias{};
  for (std::size_t i = 0; i < out.size(); ++i) {
    out[i].t_ns = static_cast<rt::TimeNs>(i) * 10 * rt::kNsPerMs;
    for (std::size_t a = 0; a < 6; ++a) {
      bias[a] += (a < 3 ? gyro_walk : accel_walk) / std::sqrt(kRateHz) * normal(random);
      const double v = bias[a] + (a < 3 ? gyro_density : accel_density) * std::sqrt(kRateHz) * normal(random);
      if (a < 3) {
        out[i].gyro_rad_s[a] = v;
      } else {
        out[i].accel_m_s2[a - 3] = v - (a == 5 ? 9.81 : 0);
      }
    }
  }
  return out;
}

TEST(Allan, FiguresOfASyntheticSensorWithinTenPerCent) {
  // Walks strong enough that two hours hold some hundreds of independent spans of the time where they show.
  const auto samples = still(7200, 1e-4, 3e-5, 2e-3, 4e-4, 5);
  const auto noise = analyse_still(samples);
  ASSERT_TRUE(noise.ok()) << noise.error().message;
  for (std::size_t a = 0; a < 6; ++a) {
    const NoiseFigures& f = noise.value().axis[a];
    EXPECT_NEAR(f.density, a < 3 ? 1e-4 : 2e-3, 0.1 * (a < 3 ? 1e-4 : 2e-3)) << a;
    EXPECT_NEAR(f.random_walk, a < 3 ? 3e-5 : 4e-4, 0.1 * (a < 3 ? 3e-5 : 4e-4)) << a;
  }
  EXPECT_NEAR(noise.value().rate_hz, kRateHz, 0.01);
  const std::string yaml = imu_yaml(noise.value());
  EXPECT_NE(yaml.find("gyroscope_noise_density: "), std::string::npos);
  EXPECT_NE(yaml.find("update_rate: 100.0000"), std::string::npos);
}

TEST(Allan, WhiteNoiseFallsWithTheRootOfTheTime) {
  const auto samples = still(1000, 1e-4, 0, 2e-3, 0, 9);
  const auto noise = analyse_still(samples);
  ASSERT_TRUE(noise.ok());
  for (const AllanPoint& p : noise.value().points[0]) {
    // Three sigma of what the point rests on.
    EXPECT_NEAR(p.deviation, 1e-4 / std::sqrt(p.tau_s), 3 / std::sqrt(p.independent) * 1e-4 / std::sqrt(p.tau_s))
        << p.tau_s;
  }
}

TEST(Allan, RecordingsThatSayNothingAreRefused) {
  EXPECT_NE(analyse_still(still(50, 1e-4, 0, 2e-3, 0, 1)).error().message.find("lasts 49 s"), std::string::npos);
  EXPECT_FALSE(analyse_still({}).ok());
  auto moved = still(200, 1e-4, 0, 2e-3, 0, 1);
  for (std::size_t i = 5000; i < 5300; ++i) moved[i].gyro_rad_s[1] += 0.2;
  EXPECT_NE(analyse_still(moved).error().message.find("was not still: its rate"), std::string::npos);
  auto holes = still(200, 1e-4, 0, 2e-3, 0, 1);
  holes.erase(holes.begin() + 3000, holes.begin() + 4000);
  EXPECT_NE(analyse_still(holes).error().message.find("are missing"), std::string::npos);
}

}  // namespace
}  // namespace godwit::hal::allan_test
