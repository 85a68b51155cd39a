// Times of readings that scatter are laid at the sensor's even pace; those that do not stay as told.
#include "vo_core/inertial/even_pace.h"

#include <cmath>
#include <gtest/gtest.h>
#include <random>
#include <vector>

#include "vo_core/inertial/imu_preintegration.h"

namespace godwit::vo::even_pace_test {
namespace {

constexpr rt::TimeNs kBegin = 1'600'000'000'123'456'789;

struct Told {
  rt::TimeNs taken_ns, told_ns;
};

/// A sensor of `rate_hz` whose clock is off by `drift`; readings whose numbers `lost` names are left out.
std::vector<Told> tell(double rate_hz, double scatter_s, int count, double drift = 0, double lost = 0,
                       unsigned seed = 3) {
  std::mt19937 engine(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform;
  std::vector<Told> out;
  for (int k = 0; k < count; ++k) {
    const double t = k / rate_hz * (1 + drift), most = 0.45 / rate_hz;
    const double off = std::clamp(scatter_s * normal(engine), -most, most);
    if (uniform(engine) < lost) continue;
    out.push_back({kBegin + std::llround(t * 1e9), kBegin + std::llround((t + off) * 1e9)});
  }
  return out;
}

/// Root mean square of what the times laid are off, from the `from`-th reading on [s].
double off_s(const std::vector<Told>& told, std::size_t from = 400) {
  EvenPace pace;
  double sum = 0, count = 0;
  rt::TimeNs last = 0;
  for (std::size_t k = 0; k < told.size(); ++k) {
    const rt::TimeNs laid = pace.lay(told[k].told_ns);
    EXPECT_GT(laid, last);
    last = laid;
    if (k < from) continue;
    sum += std::pow(rt::to_seconds(laid - told[k].taken_ns), 2);
    ++count;
  }
  return std::sqrt(sum / count);
}

TEST(EvenPace, TimesThatScatterAreLaidATenthAsFarOff) {
  for (const double rate_hz : {200.0, 400.0, 1000.0}) {
    const double scatter_s = 0.3 / rate_hz;
    for (const double drift : {0.0, 0.01, -0.02}) {
      EXPECT_LT(off_s(tell(rate_hz, scatter_s, 3000, drift)), 0.2 * scatter_s) << rate_hz << " " << drift;
      EXPECT_LT(off_s(tell(rate_hz, scatter_s, 3000, drift, 0.01)), 0.4 * scatter_s) << "one in a hundred lost";
      EXPECT_LT(off_s(tell(rate_hz, scatter_s / 4, 3000, drift, 0.1)), 0.2 * scatter_s / 4) << "one in ten";
      // So many lost, and so much scatter, that nobody can count them.
      EXPECT_LT(off_s(tell(rate_hz, scatter_s, 3000, drift, 0.1)), 1.1 * scatter_s);
    }
  }
}

TEST(EvenPace, TheScatterIsTold) {
  EvenPace pace;
  for (const Told& t : tell(1000, 2e-4, 3000)) pace.lay(t.told_ns);
  EXPECT_NEAR(pace.scatter_s(), 2e-4, 2e-5);
}

TEST(EvenPace, EvenTimesStayAsTold) {
  // As EuRoC's: in whole nanoseconds, and those rounded to 256.
  EvenPace pace;
  for (int k = 0; k < 2000; ++k) {
    const rt::TimeNs t = (kBegin + k * rt::TimeNs{5'000'000}) / 256 * 256;
    ASSERT_EQ(pace.lay(t), t) << k;
  }
}

TEST(EvenPace, AGapAndAnotherPaceBeginAnew) {
  EvenPace pace;
  for (const Told& t : tell(1000, 2e-4, 1000)) pace.lay(t.told_ns);
  // Three seconds later at 400 Hz.
  double sum = 0;
  int count = 0;
  for (const Told& t : tell(400, 2e-4, 1000, 0, 0, 5)) {
    const rt::TimeNs later = 4 * rt::kNsPerSecond, laid = pace.lay(t.told_ns + later);
    EXPECT_LT(std::abs(rt::to_seconds(laid - later - t.taken_ns)), 1.2e-3)
        << "never off by more than what was told, or half a step";
    if (++count > 400) sum += std::pow(rt::to_seconds(laid - later - t.taken_ns), 2);
  }
  EXPECT_LT(std::sqrt(sum / 600), 0.5e-4);
}

TEST(EvenPace, ASensorThatBeginsToSampleFasterIsFollowed) {
  EvenPace pace;
  for (const Told& t : tell(500, 1e-4, 1000)) pace.lay(t.told_ns);
  double worst = 0;
  int count = 0;
  for (const Told& t : tell(1000, 1e-4, 2000, 0, 0, 9)) {
    const rt::TimeNs later = 2 * rt::kNsPerSecond, laid = pace.lay(t.told_ns + later);
    if (++count > 600) worst = std::max(worst, std::abs(rt::to_seconds(laid - later - t.taken_ns)));
  }
  EXPECT_LT(worst, 1e-4);
}

TEST(EvenPace, TimesThatRepeatOrGoBackBecomeNoNewOnes) {
  EvenPace pace;
  rt::TimeNs last = 0;
  for (const Told& t : tell(1000, 2e-4, 500)) last = pace.lay(t.told_ns);
  const rt::TimeNs newest = tell(1000, 2e-4, 500).back().told_ns;
  EXPECT_EQ(pace.lay(newest), last);
  EXPECT_EQ(pace.lay(newest - rt::kNsPerMs), last);
  const rt::TimeNs back = newest - 10 * rt::kNsPerSecond;
  EXPECT_EQ(pace.lay(back), back) << "another time begins";
}

TEST(EvenPace, AShakeIsIntegratedAsIfTimesWereEven) {
  // 60 m/s^2 at 85 Hz, read a thousand times a second.
  constexpr double kRate = 2 * M_PI * 85;
  const auto way = [&](double scatter_s, bool laid, unsigned seed) {
    EvenPace pace;
    ImuBuffer buffer;
    for (const Told& t : tell(1000, scatter_s, 3000, 0, 0, seed)) {
      ImuReading r;
      r.t_ns = laid ? pace.lay(t.told_ns) : t.told_ns;
      r.accel_m_s2 = Eigen::Vector3d(60 * std::sin(kRate * rt::to_seconds(t.taken_ns - kBegin)), 0, 9.81);
      if (!buffer.add(r)) ADD_FAILURE();
    }
    Preintegration d;
    buffer.integrate(kBegin + 1'200'000'000, kBegin + 2'900'000'000, {}, &d);
    return d.dp({}).x();
  };
  double told2 = 0, laid2 = 0;
  for (unsigned seed = 1; seed <= 20; ++seed) {
    const double even = way(0, false, seed);
    told2 += std::pow(way(3e-4, false, seed) - even, 2) / 20;
    laid2 += std::pow(way(3e-4, true, seed) - even, 2) / 20;
  }
  EXPECT_GT(std::sqrt(told2), 2e-3);
  EXPECT_LT(std::sqrt(laid2), 0.15 * std::sqrt(told2));
}

}  // namespace
}  // namespace godwit::vo::even_pace_test
