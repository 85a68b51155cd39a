// Preintegration against motions known exactly, its Jacobians against differences, its covariance against many noisy
// runs.
#include "vo_core/inertial/imu_preintegration.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <memory>
#include <numbers>
#include <random>

#include "tests/vo_core/numeric_jacobian.h"

namespace godwit::vo {
namespace imu_preintegration_test {

constexpr double kG = 9.81;
const Vec3 kGravity(0, 0, -kG);

/// A motion whose derivatives are exact: the attitude about two axes, the position a sum of sines.
struct Motion {
  static Mat3 R(double t) { return so3_exp(Vec3(0, 0, 0.8 * std::sin(1.3 * t))) * so3_exp(Vec3(0.5 * t, 0, 0)); }
  static Vec3 p(double t) { return Vec3(std::sin(2 * t), 0.5 * std::cos(3 * t), 0.3 * std::sin(1.5 * t + 1)); }
  static Vec3 v(double t) { return Vec3(2 * std::cos(2 * t), -1.5 * std::sin(3 * t), 0.45 * std::cos(1.5 * t + 1)); }
  static Vec3 a(double t) { return Vec3(-4 * std::sin(2 * t), -4.5 * std::cos(3 * t), -0.675 * std::sin(1.5 * t + 1)); }
  static ImuReading reading(double t) {
    const double h = 1e-5;
    ImuReading r;
    r.t_ns = static_cast<rt::TimeNs>(std::llround(t * 1e9));
    r.gyro_rad_s = so3_log(R(t - h).transpose() * R(t + h)) / (2 * h);
    r.accel_m_s2 = R(t).transpose() * (a(t) - kGravity);
    return r;
  }
};

TEST(ImuPreintegration, FollowsAnExactMotionBetweenAnyTwoTimes) {
  const auto buffer = std::make_unique<ImuBuffer>();
  for (int i = 0; i <= 400; ++i) ASSERT_TRUE(buffer->add(Motion::reading(i / 200.0)));
  // Times between readings, not only on them.
  const double t0 = 0.4321, t1 = 1.3987, dt = t1 - t0;
  Preintegration d;
  const auto coverage = buffer->integrate(432'100'000, 1'398'700'000, {}, &d);
  EXPECT_EQ(coverage.missing_ns, 0);
  EXPECT_NEAR(d.dt_s(), dt, 1e-12);
  EXPECT_LT(so3_log((Motion::R(t0) * d.dR(Vec3::Zero())).transpose() * Motion::R(t1)).norm(), 2e-5);
  EXPECT_LT((Motion::v(t0) + kGravity * dt + Motion::R(t0) * d.dv({}) - Motion::v(t1)).norm(), 2e-4);
  EXPECT_LT(
      (Motion::p(t0) + Motion::v(t0) * dt + 0.5 * kGravity * dt * dt + Motion::R(t0) * d.dp({}) - Motion::p(t1)).norm(),
      2e-4);
}

Preintegration integrated(const ImuBias& bias) {
  Preintegration d(bias);
  for (int i = 0; i < 60; ++i) {
    const ImuReading r = Motion::reading(0.3 + i / 200.0);
    d.add(r.gyro_rad_s, r.accel_m_s2, 1 / 200.0, {});
  }
  return d;
}

TEST(ImuPreintegration, BiasJacobiansAreThoseOfDifferences) {
  const ImuBias bias{Vec3(0.02, -0.01, 0.03), Vec3(0.1, 0.2, -0.1)};
  const Preintegration d = integrated(bias);
  // The bias b + e, and what becomes of rotation, velocity and position with it.
  const auto by_gyro = [&](const Vec3& e) { return ImuBias{bias.gyro + e, bias.accel}; };
  const auto by_accel = [&](const Vec3& e) { return ImuBias{bias.gyro, bias.accel + e}; };
  const Mat3 R = d.dR(bias.gyro);
  constexpr double kStep = 1e-5;
  const auto off = [&](const auto& written, const auto& f) {
    return (test::numeric_jacobian<3>(f, kStep) - written).colwise().norm().maxCoeff();
  };
  EXPECT_LT(off(d.dR_dbg(),
                [&](const Vec3& e) { return so3_log(R.transpose() * integrated(by_gyro(e)).dR(by_gyro(e).gyro)); }),
            1e-6);
  EXPECT_LT(off(d.dv_dbg(), [&](const Vec3& e) { return integrated(by_gyro(e)).dv(by_gyro(e)); }), 1e-6);
  EXPECT_LT(off(d.dp_dbg(), [&](const Vec3& e) { return integrated(by_gyro(e)).dp(by_gyro(e)); }), 1e-6);
  EXPECT_LT(off(d.dv_dba(), [&](const Vec3& e) { return integrated(by_accel(e)).dv(by_accel(e)); }), 1e-6);
  EXPECT_LT(off(d.dp_dba(), [&](const Vec3& e) { return integrated(by_accel(e)).dp(by_accel(e)); }), 1e-6);
}

TEST(ImuPreintegration, AnotherBiasIsReachedToFirstOrder) {
  const ImuBias bias, moved{Vec3(0.01, -0.02, 0.01), Vec3(0.1, -0.1, 0.05)};
  const Preintegration d = integrated(bias), exact = integrated(moved);
  EXPECT_LT(so3_log(d.dR(moved.gyro).transpose() * exact.dR(moved.gyro)).norm(), 1e-4);
  EXPECT_LT((d.dv(moved) - exact.dv(moved)).norm(), 1e-3);
  EXPECT_LT((d.dp(moved) - exact.dp(moved)).norm(), 1e-4);
}

TEST(ImuPreintegration, CovarianceIsThatOfManyNoisyRuns) {
  ImuNoise noise;
  noise.gyro = 2e-3;
  noise.accel = 2e-2;
  std::mt19937 engine(3);
  std::normal_distribution<double> normal;
  const Preintegration mean = integrated({});
  Preintegration told;
  for (int i = 0; i < 60; ++i) {
    const ImuReading r = Motion::reading(0.3 + i / 200.0);
    told.add(r.gyro_rad_s, r.accel_m_s2, 1 / 200.0, noise);
  }
  const auto random = [&] { return Vec3(normal(engine), normal(engine), normal(engine)); };
  const Eigen::LLT<Mat9> llt(told.covariance());
  double nees = 0;
  Vec9 each = Vec9::Zero();
  constexpr int kRuns = 3000;
  for (int run = 0; run < kRuns; ++run) {
    Preintegration d;
    for (int i = 0; i < 60; ++i) {
      const ImuReading r = Motion::reading(0.3 + i / 200.0);
      d.add(r.gyro_rad_s + noise.gyro * std::sqrt(200.0) * random(),
            r.accel_m_s2 + noise.accel * std::sqrt(200.0) * random(), 1 / 200.0, noise);
    }
    Vec9 e;
    e << so3_log(mean.dR(Vec3::Zero()).transpose() * d.dR(Vec3::Zero())), d.dv({}) - mean.dv({}),
        d.dp({}) - mean.dp({});
    nees += e.dot(llt.solve(e)) / 9 / kRuns;
    each += e.cwiseAbs2() / kRuns;
  }
  EXPECT_NEAR(nees, 1.0, 0.05);
  for (int i = 0; i < 9; ++i) EXPECT_NEAR(each[i] / told.covariance()(i, i), 1.0, 0.12) << i;
}

TEST(ImuPreintegration, RightJacobianAndItsInverse) {
  const Vec3 w(0.4, -0.7, 0.3), d(1e-6, -2e-6, 1.5e-6);
  EXPECT_LT((so3_log(so3_exp(w).transpose() * so3_exp(w + d)) - so3_right_jacobian(w) * d).norm(), 1e-11);
  for (const Vec3& x : {w, Vec3(1e-7, 0, 2e-7), Vec3(1e-4, 2e-4, -1e-4)}) {
    EXPECT_LT((so3_right_jacobian(x) * so3_right_jacobian_inverse(x) - Mat3::Identity()).norm(), 1e-9);
  }
}

TEST(ImuBuffer, TellsWhatIsMissing) {
  const auto buffer = std::make_unique<ImuBuffer>();
  const rt::TimeNs ms = rt::kNsPerMs;
  Preintegration none;
  EXPECT_EQ(buffer->integrate(0, 10 * ms, {}, &none).missing_ns, 10 * ms);
  EXPECT_EQ(none.dt_s(), 0);
  for (int i = 0; i <= 100; ++i) {
    if (i > 40 && i < 60) continue;
    ImuReading r;
    r.t_ns = 100 * ms + i * 5 * ms;
    r.gyro_rad_s = Vec3(0, 0, 0.5);
    buffer->add(r);
  }
  const auto integrate = [&](rt::TimeNs t0, rt::TimeNs t1) {
    Preintegration d;
    const auto c = buffer->integrate(t0, t1, {}, &d);
    // Whatever is missing, the turn goes on as it was.
    EXPECT_NEAR(so3_log(d.dR(Vec3::Zero())).z(), 0.5 * rt::to_seconds(t1 - t0), 1e-9);
    return c.missing_ns;
  };
  EXPECT_EQ(integrate(110 * ms, 290 * ms), 0);
  EXPECT_EQ(integrate(90 * ms, 110 * ms), 10 * ms);
  EXPECT_EQ(integrate(590 * ms, 604 * ms), 4 * ms);
  EXPECT_EQ(integrate(290 * ms, 410 * ms), 100 * ms);
  EXPECT_EQ(integrate(700 * ms, 720 * ms), 20 * ms);
  EXPECT_EQ(integrate(10 * ms, 20 * ms), 10 * ms);
}

TEST(ImuBuffer, RowsTurnBesideASteadyTurnByWhatShakes) {
  // 85 Hz of 2 mrad about y on a turn that is steady and a bias, one reading a millisecond, a picture each 33 ms whose
  // rows are read within 15 ms.
  constexpr double kAmplitude = 2e-3, kRate = 2 * std::numbers::pi * 85;
  constexpr rt::TimeNs kSpan = 15 * rt::kNsPerMs, kBefore = 300 * rt::kNsPerMs, kNow = 333 * rt::kNsPerMs;
  const auto turned = [&](double t) { return kAmplitude * std::sin(kRate * t); };
  const auto fill = [&](const Vec3& bias, rt::TimeNs until, rt::TimeNs gap_at, bool saturated) {
    auto buffer = std::make_unique<ImuBuffer>();
    for (rt::TimeNs t = 0; t <= until; t += rt::kNsPerMs) {
      if (t > gap_at && t <= gap_at + 31 * rt::kNsPerMs) continue;
      ImuReading r;
      r.t_ns = t;
      r.gyro_rad_s = Vec3(0.3, kAmplitude * kRate * std::cos(kRate * rt::to_seconds(t)), 0) + bias;
      r.gyro_saturated = saturated && t == kNow;
      buffer->add(r);
    }
    return buffer;
  };
  constexpr rt::TimeNs kNever = rt::kNsPerSecond;
  std::array<Vec3, 24> turns, rates, biased, unused;
  const auto buffer = fill(Vec3::Zero(), 400 * rt::kNsPerMs, kNever, false);
  ASSERT_TRUE(buffer->row_turns(kBefore, kNow, kSpan, turns, rates));
  ASSERT_TRUE(fill(Vec3(0.05, -0.02, 0.03), 400 * rt::kNsPerMs, kNever, false)
                  ->row_turns(kBefore, kNow, kSpan, biased, unused));
  const auto time_of = [&](rt::TimeNs middle, std::size_t k) {
    return rt::to_seconds(middle) + rt::to_seconds(kSpan) * (static_cast<double>(k) / 23 - 0.5);
  };
  const auto mean_of_rows = [&](rt::TimeNs middle) {
    double sum = 0;
    for (std::size_t k = 0; k < 24; ++k) sum += (k == 0 || k == 23 ? 0.5 : 1.0) * turned(time_of(middle, k)) / 23;
    return sum;
  };
  const double now = mean_of_rows(kNow), steady = (now - mean_of_rows(kBefore)) / rt::to_seconds(kNow - kBefore);
  double most = 0;
  for (std::size_t k = 0; k < 24; ++k) {
    const double t = time_of(kNow, k);
    most = std::max(most, std::abs(turns[k].y()));
    EXPECT_NEAR(turns[k].y(), turned(t) - now - steady * (t - rt::to_seconds(kNow)), 0.05 * kAmplitude) << k;
    EXPECT_NEAR(rates[k].y(), kAmplitude * kRate * std::cos(kRate * t) - steady, 0.05 * kAmplitude * kRate) << k;
    EXPECT_LT(std::hypot(turns[k].x(), turns[k].z()), 1e-9) << "a steady turn has none";
    EXPECT_LT((turns[k] - biased[k]).norm(), 1e-9) << "nor has a bias";
  }
  EXPECT_GT(most, 0.7 * kAmplitude) << "or nothing was tested";
  // Where it was not measured nothing is told: readings that end before the rows do, a gap, a saturated one.
  const auto left = turns;
  EXPECT_FALSE(fill(Vec3::Zero(), kNow, kNever, false)->row_turns(kBefore, kNow, kSpan, turns, rates));
  EXPECT_FALSE(fill(Vec3::Zero(), 400 * rt::kNsPerMs, kBefore, false)->row_turns(kBefore, kNow, kSpan, turns, rates));
  EXPECT_FALSE(fill(Vec3::Zero(), 400 * rt::kNsPerMs, kNever, true)->row_turns(kBefore, kNow, kSpan, turns, rates));
  EXPECT_FALSE(buffer->row_turns(kBefore, kNow, 0, turns, rates)) << "a global shutter";
  EXPECT_FALSE(buffer->row_turns(kNow, kNow, kSpan, turns, rates));
  EXPECT_FALSE(buffer->row_turns(0, 5 * rt::kNsPerMs, kSpan, turns, rates)) << "before the first reading";
  EXPECT_FALSE(ImuBuffer().row_turns(kBefore, kNow, kSpan, turns, rates));
  EXPECT_EQ(turns, left);
}

TEST(ImuBuffer, TimesThatScatterCountAsNoiseWhereItShakes) {
  // 60 m/s^2 at 85 Hz, read a thousand times a second, by a clock that is off by a third of a millisecond each time.
  constexpr double kForce = 60, kRate = 2 * M_PI * 85, kScatterS = 0.3e-3;
  std::mt19937 engine(7);
  std::normal_distribution<double> normal;
  const auto fly = [&](double scatter_s, double phase, Preintegration* d) {
    ImuBuffer buffer;
    for (int k = 0; k <= 300; ++k) {
      ImuReading r;
      const double t = 1e-3 * k, off = std::clamp(scatter_s * normal(engine), -0.45e-3, 0.45e-3);
      r.t_ns = std::llround((t + off) * 1e9);
      r.accel_m_s2 = Vec3(kForce * std::sin(kRate * t + phase), 0, kG);
      if (!buffer.add(r)) ADD_FAILURE() << k;
    }
    buffer.integrate(std::llround(0.1 * 1e9), std::llround(0.2 * 1e9), {}, d);
    return buffer.time_scatter_s();
  };
  double off2 = 0, told = 0, scatter = 0;
  constexpr int kRuns = 200;
  for (int run = 0; run < kRuns; ++run) {
    const double phase = 0.1 * run;
    Preintegration even, uneven;
    EXPECT_EQ(fly(0, phase, &even), 0) << "even times";
    scatter += fly(kScatterS, phase, &uneven) / kRuns;
    const double off = uneven.dv({}).x() - even.dv({}).x();
    off2 += off * off / kRuns;
    told += uneven.covariance()(3, 3) / kRuns;
    EXPECT_LT(even.covariance()(3, 3), 2e-5);
  }
  EXPECT_NEAR(scatter, kScatterS, 0.3 * kScatterS);
  // The noise is told alike along all axes: the two that do not shake get a third of it each.
  EXPECT_NEAR(std::sqrt(off2 / (3 * told)), 1, 0.4);
  EXPECT_GT(told, 1e-4);
}

TEST(ImuBuffer, WhatIsSaturatedIsOffByHalfOfItsRangeForAsLongAsItIs) {
  // From 100 to 150 ms: 80 m/s^2 along x, and 10 rad/s about z.
  const auto ms = [](int t) { return t * rt::kNsPerMs; };
  ImuBuffer buffer, silent;
  for (int k = 0; k <= 60; ++k) {
    ImuReading r;
    r.t_ns = ms(5 * k);
    const bool ends = k >= 20 && k <= 30;
    r.accel_m_s2 = Vec3(ends ? 80 : 1, 2, kG);
    silent.add(r);
    r.accel_saturated = ends;
    buffer.add(r);
  }
  const auto integrated = [&](const ImuBuffer& of, int from, int to) {
    Preintegration d;
    EXPECT_EQ(of.integrate(ms(from), ms(to), {}, &d).accel_saturated, &of == &buffer && from < 155 && to > 95);
    return d;
  };
  const Preintegration all = integrated(buffer, 0, 300), without = integrated(silent, 0, 300);
  EXPECT_EQ(all.dv({}), without.dv({})) << "its mean is what was read";
  const auto sigma = [](const Preintegration& d, int part) { return std::sqrt(d.covariance()(part, part)); };
  // With the steps that lead there and away.
  EXPECT_NEAR(sigma(all, 3), 40 * 0.055, 40 * 0.001) << "all of it goes one way";
  EXPECT_LT(sigma(all, 4), 1.1 * sigma(without, 4)) << "other axes are what they were";
  EXPECT_NEAR(sigma(all, 6), 40 * 0.055 * 0.17, 0.05 * sigma(all, 6)) << "and it is flown on with";
  EXPECT_EQ(integrated(buffer, 0, 90).covariance(), integrated(silent, 0, 90).covariance());
  EXPECT_EQ(integrated(buffer, 160, 300).covariance(), integrated(silent, 160, 300).covariance());
  // Who integrates piece by piece knows no more and no less.
  double pieces = 0;
  for (int t = 0; t < 300; t += 20) pieces += integrated(buffer, t, t + 20).covariance()(3, 3);
  EXPECT_NEAR(std::sqrt(pieces), sigma(all, 3), 0.02 * sigma(all, 3));

  ImuBuffer turning;
  for (int k = 0; k <= 60; ++k) {
    ImuReading r;
    r.t_ns = ms(5 * k);
    r.gyro_saturated = k >= 20 && k <= 30;
    r.gyro_rad_s = Vec3(0, 0, r.gyro_saturated ? 10 : 0);
    turning.add(r);
  }
  Preintegration turned;
  EXPECT_TRUE(turning.integrate(0, ms(300), {}, &turned).saturated());
  EXPECT_NEAR(sigma(turned, 2), 5 * 0.055, 5 * 0.001);
  EXPECT_LT(sigma(turned, 0), 1e-3);
}

TEST(ImuBuffer, RefusesNonsenseAndKeepsTwoSeconds) {
  const auto buffer = std::make_unique<ImuBuffer>();
  ImuReading r;
  for (int i = 0; i < 10'000; ++i) {
    r.t_ns = i * rt::kNsPerMs;
    EXPECT_TRUE(buffer->add(r));
  }
  EXPECT_FALSE(buffer->add(r)) << "the same time again";
  r.t_ns += rt::kNsPerMs;
  r.accel_m_s2.x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(buffer->add(r));
  r.accel_m_s2.x() = 0;
  r.gyro_rad_s.y() = std::numeric_limits<double>::infinity();
  EXPECT_FALSE(buffer->add(r));
  EXPECT_EQ(buffer->refused(), 3u);
  Preintegration d;
  EXPECT_EQ(buffer->integrate(8000 * rt::kNsPerMs, 9999 * rt::kNsPerMs, {}, &d).missing_ns, 0);
  EXPECT_EQ(buffer->integrate(7900 * rt::kNsPerMs, 8000 * rt::kNsPerMs, {}, &d).missing_ns > 0, true);
  // A clock that was set back by more than is kept begins anew.
  r = {};
  r.t_ns = 5;
  EXPECT_TRUE(buffer->add(r));
  EXPECT_EQ(buffer->newest_ns(), 5);
}

}  // namespace imu_preintegration_test
}  // namespace godwit::vo
