#include "vo_core/tracking/motion_prior.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <gtest/gtest.h>
#include <random>

namespace godwit::vo {
namespace motion_prior_test {

constexpr double kInterval = 1.0 / 30.0, kDepth = 2.0;

Mat6 measurement(double place, double turn) {
  Vec6 variance;
  variance << Vec3::Constant(place * place), Vec3::Constant(turn * turn);
  return variance.asDiagonal();
}

void take(MotionPrior* prior, const PosePrediction& predicted, const SE3& T, const Mat6& covariance) {
  if (predicted.known) {
    prior->measured(predicted, T, covariance);
  } else {
    prior->begin(Vec6::Zero(), covariance, kDepth);
  }
}

/// The pose that prediction and picture have together, and its covariance: as pose_optimizer.cpp has it.
std::pair<SE3, Mat6> together(const PosePrediction& predicted, const SE3& seen, const Mat6& noise) {
  if (!predicted.known) return {seen, noise};
  const Mat6 covariance = (predicted.information + noise.inverse()).inverse();
  const Vec6 off = (seen * predicted.T_cam_world.inverse()).log();
  return {SE3::exp(covariance * noise.inverse() * off) * predicted.T_cam_world, covariance};
}

TEST(MotionPrior, NothingIsKnownBeforeTheFirstPoseNorAfterALoss) {
  MotionPrior prior;
  EXPECT_FALSE(prior.predict({}, kInterval, kDepth).known);
  prior.begin(Vec6::Zero(), measurement(0.001, 0.001), kDepth);
  EXPECT_TRUE(prior.predict({}, kInterval, kDepth).known);
  EXPECT_FALSE(prior.predict({}, 0.0, kDepth).known) << "two pictures of one time";
  prior.forget();
  EXPECT_FALSE(prior.predict({}, kInterval, kDepth).known);
}

TEST(MotionPrior, OfAFirstPoseTheVelocityMayBeAnything) {
  MotionPrior prior;
  prior.begin(Vec6::Zero(), measurement(0.001, 0.001), kDepth);
  const PosePrediction p = prior.predict({}, kInterval, kDepth);
  const Mat6 covariance = p.information.inverse();
  const MotionPriorOptions o;
  EXPECT_NEAR(std::sqrt(covariance(0, 0)), o.first_speed * kDepth * kInterval, 0.02);
  EXPECT_NEAR(std::sqrt(covariance(3, 3)), o.first_turn * kInterval, 0.01);
}

TEST(MotionPrior, WhatIsKnownOfTheMotionSpeaksForThePosesItLeadsTo) {
  MotionPrior prior;
  const Mat6 noise = measurement(0.001, 0.001);
  EXPECT_EQ(prior.predict({}, kInterval, kDepth).evidence({}), 0.0) << "nothing is known";
  prior.begin(Vec6::Zero(), noise, kDepth);
  // Of a first pose hardly more than that a camera is there.
  EXPECT_NEAR(prior.predict({}, kInterval, kDepth).evidence({}), 0.0, 0.1);
  for (int i = 0; i < 20; ++i) {
    const PosePrediction p = prior.predict({}, kInterval, kDepth);
    prior.measured(p, {}, together(p, {}, noise).second);
  }
  const PosePrediction p = prior.predict({}, kInterval, kDepth);
  EXPECT_GT(p.evidence({}), 15.0);
  // Three sigmas aside, 4.5 nats less.
  const double sigma = 1.0 / std::sqrt(p.information(0, 0));
  EXPECT_NEAR(p.evidence(SE3::exp((Vec6() << 3.0 * sigma, 0, 0, 0, 0, 0).finished())), p.evidence({}) - 4.5, 1e-9);
}

TEST(MotionPrior, AConstantTwistGoesOnOverAnyInterval) {
  MotionPrior prior;
  const Vec6 rate = (Vec6() << 0.6, -0.2, 0.1, 0.05, 0.4, -0.1).finished();
  SE3 T;
  PosePrediction p;
  for (int i = 0; i < 20; ++i) {
    take(&prior, p, T, measurement(1e-5, 1e-5));
    p = prior.predict(T, kInterval, kDepth);
    T = SE3::exp(kInterval * rate) * T;
  }
  EXPECT_LT((T * p.T_cam_world.inverse()).log().norm(), 1e-4);
  // Nothing was found in that picture, nor in the two after it.
  const SE3 last = SE3::exp(-kInterval * rate) * T;
  p = prior.predict(last, 4.0 * kInterval, kDepth);
  EXPECT_LT((SE3::exp(3.0 * kInterval * rate) * T * p.T_cam_world.inverse()).log().norm(), 4e-4);
  // The map was put right meanwhile: the camera goes on from where it is.
  const SE3 moved = last * SE3::exp((Vec6() << 0.1, 0.2, 0.0, 0.0, 0.0, 0.3).finished());
  p = prior.predict(moved, kInterval, kDepth);
  EXPECT_LT((SE3::exp(kInterval * rate) * moved * p.T_cam_world.inverse()).log().norm(), 1e-4);
}

TEST(MotionPrior, TheSameTimeIsAsUnsureInOneStepAsInThree) {
  // Nothing is measured between them: a measurement that says nothing.
  const Mat6 nothing = measurement(1e6, 1e6);
  MotionPrior steps;
  PosePrediction p;
  SE3 T;
  for (int i = 0; i < 10; ++i) {
    const auto [pose, covariance] = together(p, {}, measurement(0.002, 0.001));
    take(&steps, p, pose, covariance);
    T = pose;
    p = steps.predict(T, kInterval, kDepth);
  }
  MotionPrior one = steps;
  const Mat6 at_once = one.predict(T, 3.0 * kInterval, kDepth).information.inverse();
  for (int i = 0; i < 2; ++i) {
    const auto [pose, covariance] = together(p, p.T_cam_world, nothing);
    take(&steps, p, pose, covariance);
    p = steps.predict(pose, kInterval, kDepth);
  }
  const Mat6 in_steps = p.information.inverse();
  EXPECT_LT((at_once - in_steps).norm(), 1e-6 * at_once.norm()) << at_once << "\n\n" << in_steps;
}

TEST(MotionPrior, APredictionIsAsSureAsItSays) {
  // White acceleration as the options have it, and measurements whose noise is known: the normalised error of what is
  // predicted, squared, has a mean of six.
  const MotionPriorOptions o;
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  const auto draw = [&](double place, double turn) {
    Vec6 x;
    for (int k = 0; k < 6; ++k) x(k) = (k < 3 ? place : turn) * normal(random);
    return x;
  };
  double sum = 0.0;
  int n = 0;
  for (int run = 0; run < 40; ++run) {
    MotionPrior prior;
    Vec6 rate = draw(0.3, 0.1);
    SE3 truth, told;
    PosePrediction p;
    for (int i = 0; i < 60; ++i) {
      constexpr double kPlace = 0.004, kTurn = 0.001;
      const Mat6 noise = measurement(kPlace, kTurn);
      const auto [pose, covariance] = together(p, SE3::exp(draw(kPlace, kTurn)) * truth, noise);
      take(&prior, p, pose, covariance);
      told = pose;
      p = prior.predict(told, kInterval, kDepth);
      // Of an acceleration that is white over the interval: what it makes of the rate, and of the way beside that.
      const Vec6 rate_step = std::sqrt(kInterval) * draw(o.acceleration * kDepth, o.turn_acceleration);
      const Vec6 beside =
          std::sqrt(kInterval * kInterval * kInterval / 12.0) * draw(o.acceleration * kDepth, o.turn_acceleration);
      truth = SE3::exp(kInterval * (rate + 0.5 * rate_step) + beside) * truth;
      rate += rate_step;
      if (i < 10) continue;
      const Vec6 e = (p.T_cam_world * truth.inverse()).log();
      sum += e.dot(p.information * e);
      ++n;
    }
  }
  EXPECT_GT(sum / n, 5.5);
  EXPECT_LT(sum / n, 6.5);
}

}  // namespace motion_prior_test
}  // namespace godwit::vo
