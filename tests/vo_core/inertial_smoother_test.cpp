// Factors against differences; alignment and smoother on a motion known exactly, with noise, at rest, and over long.
#include "vo_core/inertial/inertial_smoother.h"

#include <cmath>
#include <gtest/gtest.h>
#include <memory>
#include <random>
#include <vector>

#include "tests/vo_core/inertial_flight.h"
#include "tests/vo_core/numeric_jacobian.h"
#include "vo_core/inertial/inertial_alignment.h"

namespace godwit::vo {
namespace inertial_smoother_test {

using S = InertialState;
using test::Flight;
using test::kUpInMap;

InertialState some_state(int salt) {
  std::mt19937 engine(static_cast<unsigned>(salt));
  std::normal_distribution<double> normal;
  const auto v = [&](double s) { return Vec3(s * normal(engine), s * normal(engine), s * normal(engine)); };
  InertialState x;
  x.R_map_body = so3_exp(v(0.7));
  x.camera = v(0.5);
  x.velocity = v(1.0);
  x.bias = {v(0.03), v(0.1)};
  x.log_scale = 0.7 + 0.1 * normal(engine);
  x.up = (kUpInMap + v(0.02)).normalized();
  x.mounting = v(0.02);
  x.time_offset_s = 0.01 * normal(engine);
  x.course = v(0.05);
  return x;
}

VisionSight some_sight(const InertialState& x, const CameraMounting& m, int salt) {
  VisionSight s;
  s.R_map_cam = x.R_map_body * m.R_body_cam * so3_exp(Vec3(0.01, -0.02, 0.015 + 0.001 * salt));
  s.camera = x.camera + Vec3(0.01, 0.02, -0.01 * salt);
  s.gyro_rad_s = Vec3(0.5, -0.4, 0.3 * salt);
  return s;
}

TEST(InertialFactors, JacobiansAreThoseOfDifferences) {
  const CameraMounting m = test::slanted_mounting();
  const InertialState i = some_state(1), j = some_state(2);
  const VisionSight at_i = some_sight(i, m, 1), at_j = some_sight(j, m, 2);
  Preintegration d(ImuBias{Vec3(0.01, 0, 0.01), Vec3(0, 0.05, 0)});
  for (int k = 0; k < 20; ++k) d.add(Vec3(0.5, -0.4, 0.3 + 0.02 * k), Vec3(1, 2, 9.0), 0.005, {});
  const InertialModel model;
  PairJacobian J_i, J_j;
  pair_residual(i, j, d, at_i, at_j, m, model, &J_i, &J_j);
  SightJacobian V;
  sight_residual(i, at_i, m, &V);
  const auto pair = [&](const InertialState& a, const InertialState& b) {
    return pair_residual(a, b, d, at_i, at_j, m, model, nullptr, nullptr);
  };
  using E = S::Error;
  auto by_i = test::numeric_jacobian<S::kSize>([&](const E& e) { return pair(i.plus(e), j); });
  // Of the slow vertical only to first order in its change: its basis turns with it.
  by_i.block<2, 2>(16, S::kUp) = J_i.block<2, 2>(16, S::kUp);
  EXPECT_LT((by_i - J_i).cwiseAbs().maxCoeff(), 2e-6) << "by i\n" << by_i - J_i;
  const auto by_j = test::numeric_jacobian<S::kSize>([&](const E& e) { return pair(i, j.plus(e)); });
  EXPECT_LT((by_j - J_j).cwiseAbs().maxCoeff(), 2e-6) << "by j\n" << by_j - J_j;
  const auto by_sight =
      test::numeric_jacobian<S::kSize>([&](const E& e) { return sight_residual(i.plus(e), at_i, m, nullptr); });
  EXPECT_LT((by_sight - V).cwiseAbs().maxCoeff(), 2e-6) << "sight\n" << by_sight - V;
}

TEST(InertialState, PlusAndMinusAreInverse) {
  const InertialState x = some_state(5);
  S::Error e;
  for (int k = 0; k < S::kSize; ++k) e[k] = 0.001 * (k - 8);
  EXPECT_LT((x.plus(e).minus(x) - e).norm(), 1e-5);
  EXPECT_NEAR(x.plus(e).up.norm(), 1, 1e-12);
}

/// The smoother over the first `moments` of a flight, begun by a closed form.
std::unique_ptr<InertialSmoother> begun(Flight* f, int moments, AlignmentMethod method, Alignment* found,
                                        InertialSmoother::Report* report) {
  std::vector<InertialNode> nodes;
  nodes.reserve(static_cast<std::size_t>(moments));
  for (int k = 0; k < moments; ++k) nodes.push_back(f->node(k, {}));
  ImuBias bias;
  bias.gyro = align_gyro_bias(nodes, f->mounting_, bias, 0.1, 2e-4);
  *found = align(nodes, f->mounting_, bias, kStandardGravity, method);
  auto smoother = std::make_unique<InertialSmoother>(f->mounting_, f->model_);
  smoother->add(nodes[0]);
  InertialState& x = smoother->state(0);
  x.bias = found->bias;
  x.log_scale = found->log_scale;
  x.up = found->up;
  x.velocity = found->velocity;
  for (int k = 1; k < moments; ++k) smoother->add(nodes[static_cast<std::size_t>(k)]);
  smoother->set_prior({});
  *report = smoother->solve(10);
  return smoother;
}

TEST(InertialAlignment, BothFormsFindScaleAndVertical) {
  for (const AlignmentMethod method : {AlignmentMethod::kStepwise, AlignmentMethod::kWhole}) {
    for (unsigned seed = 1; seed <= 8; ++seed) {
      Flight f(1.0, seed);
      Alignment found;
      InertialSmoother::Report report;
      const auto smoother = begun(&f, 40, method, &found, &report);
      ASSERT_TRUE(found.ok);
      EXPECT_NEAR(found.log_scale, std::log(f.scale_), method == AlignmentMethod::kWhole ? 0.06 : 0.25) << seed;
      EXPECT_LT(angle_between(found.up, kUpInMap), 0.035) << seed;
      ASSERT_TRUE(report.ok);
      EXPECT_NEAR(smoother->newest().log_scale, std::log(f.scale_), 0.02) << seed;
      EXPECT_LT(angle_between(smoother->newest().up, kUpInMap), 0.02) << seed;
      EXPECT_LT((smoother->newest().bias.gyro - f.bias_.gyro).norm(), 0.01) << seed;
    }
  }
}

TEST(InertialAlignment, TurnsAboutOtherAxesAreToldFromTurnsThatAreTooSmall) {
  for (unsigned seed = 1; seed <= 8; ++seed) {
    for (const double amplitude : {1.0, 1e-6}) {
      Flight f(amplitude, seed);
      std::vector<InertialNode> nodes;
      for (int k = 0; k < 24; ++k) nodes.push_back(f.node(k, {}));
      const TurnAgreement right = agreement_of_turns(nodes, f.mounting_, {});
      EXPECT_FALSE(right.about_other_axes()) << seed;
      EXPECT_LE(right.cosine, right.best + 1e-12) << seed;
      // As vision would have it if the body's z axis, and with it x, pointed the other way.
      CameraMounting turned = f.mounting_;
      turned.R_body_cam = Vec3(-1, 1, -1).asDiagonal() * turned.R_body_cam;
      const TurnAgreement wrong = agreement_of_turns(nodes, turned, {});
      EXPECT_NEAR(wrong.best, right.best, 1e-9) << "axes do not matter for that";
      EXPECT_EQ(wrong.about_other_axes(), amplitude == 1.0) << seed << ": " << wrong.cosine << ", " << wrong.best;
      EXPECT_GT(right.cosine, amplitude == 1.0 ? 0.995 : -1.0) << seed;
    }
  }
  EXPECT_EQ(agreement_of_turns({}, test::slanted_mounting(), {}).best, 0);
}

TEST(InertialSmoother, ItsCovarianceHolds) {
  // Scale, vertical and velocity of 60 flights, over windows that have slid: in units of their own sigmas.
  double scale2 = 0, up2 = 0, speed2 = 0, bias2 = 0;
  constexpr int kFlights = 60;
  for (unsigned seed = 1; seed <= kFlights; ++seed) {
    Flight f(1.0, 100 + seed);
    Alignment found;
    InertialSmoother::Report report;
    const auto smoother = begun(&f, 30, AlignmentMethod::kWhole, &found, &report);
    ASSERT_TRUE(found.ok && report.ok) << seed;
    for (int k = 30; k < 120; ++k) {
      smoother->add(f.node(k, smoother->newest().bias));
      if (k % 10 == 9) {
        ASSERT_TRUE(smoother->solve(3).ok);
      }
    }
    InertialState truth = smoother->newest();
    truth.log_scale = std::log(f.scale_);
    truth.up = kUpInMap;
    truth.velocity = f.R_map_world_ * f.v(119 / 20.0);
    truth.bias = f.bias_;
    const S::Error e = truth.minus(smoother->newest());
    const auto share = [&](auto part, int index) {
      constexpr int kN = decltype(part)::value;
      const Eigen::Matrix<double, kN, 1> x = e.segment<kN>(index);
      const Eigen::Matrix<double, kN, kN> C = smoother->covariance().template block<kN, kN>(index, index);
      return x.dot(C.llt().solve(x)) / kN / kFlights;
    };
    scale2 += share(std::integral_constant<int, 1>(), S::kScale);
    up2 += share(std::integral_constant<int, 2>(), S::kUp);
    speed2 += share(std::integral_constant<int, 3>(), S::kVelocity);
    bias2 += share(std::integral_constant<int, 3>(), S::kGyroBias);
  }
  // The flights' mounting and clock are perfect, the prior allows for errors: below one is no fault.
  EXPECT_LT(scale2, 1.6);
  EXPECT_GT(scale2, 0.2);
  EXPECT_LT(up2, 1.6);
  EXPECT_LT(speed2, 1.6);
  EXPECT_LT(bias2, 1.6);
}

TEST(InertialSmoother, AtRestItKnowsThatItDoesNotKnowTheScale) {
  int solved = 0;
  for (unsigned seed = 1; seed <= 10; ++seed) {
    Flight f(1e-6, seed);
    Alignment found;
    InertialSmoother::Report report;
    const auto smoother = begun(&f, 48, AlignmentMethod::kWhole, &found, &report);
    if (!found.ok || !report.ok) continue;
    EXPECT_GT(std::sqrt(smoother->covariance()(S::kScale, S::kScale)), 0.08) << seed;
    ++solved;
  }
  EXPECT_GT(solved, 0);
}

TEST(InertialSmoother, AMapThatMovesTakesAllAlong) {
  Flight f(1.0, 3);
  Alignment found;
  InertialSmoother::Report report;
  const auto smoother = begun(&f, 30, AlignmentMethod::kWhole, &found, &report);
  const InertialState before = smoother->newest();
  const Mat3 turn = so3_exp(Vec3(0.02, -0.01, 0.03));
  const Vec3 pivot(1, 2, 3), shift(0.1, 0, -0.2);
  // All of it before the first moment: as one.
  smoother->correct_map({0, 0, pivot, so3_log(turn), shift});
  ASSERT_TRUE(smoother->solve(5).ok);
  EXPECT_LT((smoother->newest().camera - (pivot + turn * (before.camera - pivot) + shift)).norm(), 1e-3);
  EXPECT_NEAR(smoother->newest().log_scale, before.log_scale, 2e-3);
  EXPECT_LT(angle_between(smoother->newest().up, turn * before.up), 1e-3);
}

TEST(InertialSmoother, ACorrectionMovesWhatWasSeenWhileVisionStrayed) {
  Flight f(1.0, 3);
  Alignment found;
  InertialSmoother::Report report;
  const auto smoother = begun(&f, 30, AlignmentMethod::kWhole, &found, &report);
  std::vector<Vec3> before;
  before.reserve(30);
  for (int i = 0; i < 30; ++i) before.push_back(smoother->node(i).sight.camera);
  const Vec3 shift(0.1, 0, -0.2);
  const rt::TimeNs to_ns = smoother->node(29).t_ns;
  smoother->correct_map({to_ns - rt::kNsPerSecond / 2, to_ns, before.back(), Vec3::Zero(), shift});
  const auto moved = [&](int i) { return smoother->node(i).sight.camera - before[static_cast<std::size_t>(i)]; };
  EXPECT_LT((moved(29) - shift).norm(), 1e-12);
  EXPECT_LT((moved(24) - 0.5 * shift).norm(), 1e-6);
  EXPECT_LT(moved(19).norm(), 1e-6);
  EXPECT_LT(moved(0).norm(), 1e-12);
}

}  // namespace inertial_smoother_test
}  // namespace godwit::vo
