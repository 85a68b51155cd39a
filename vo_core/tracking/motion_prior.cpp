#include "vo_core/tracking/motion_prior.h"

#include <Eigen/Cholesky>
#include <cmath>

namespace godwit::vo {

PosePrediction MotionPrior::predict(const SE3& T_last, double dt, double depth) {
  PosePrediction out;
  if (!known_ || !(dt > 0.0)) return out;
  const double a = options_.acceleration * depth, w = options_.turn_acceleration;
  Vec6 density;
  density << Vec3::Constant(a * a), Vec3::Constant(w * w);
  ahead_ = last_;
  ahead_.pose += dt * (last_.rate_pose + last_.rate_pose.transpose()) + dt * dt * last_.rate;
  ahead_.pose.diagonal() += dt * dt * dt / 3.0 * density;
  ahead_.rate_pose += dt * last_.rate;
  ahead_.rate_pose.diagonal() += dt * dt / 2.0 * density;
  ahead_.rate.diagonal() += dt * density;
  const Eigen::LDLT<Mat6> ldlt(ahead_.pose);
  out.T_cam_world = SE3::exp(dt * rate_) * T_last;
  out.information = ldlt.solve(Mat6::Identity());
  out.known = ldlt.info() == Eigen::Success && ldlt.isPositive() && out.information.allFinite();
  const double v = options_.first_speed * depth * dt, turn = options_.first_turn * dt;
  out.most_evidence = 3.0 * std::log(v * turn) - 0.5 * ldlt.vectorD().array().log().sum();
  return out;
}

void MotionPrior::begin(const Vec6& rate, const Mat6& covariance, double depth) {
  known_ = true;
  rate_ = rate;
  last_ = {};
  last_.pose = covariance;
  const double v = options_.first_speed * depth, w = options_.first_turn;
  last_.rate.diagonal() << Vec3::Constant(v * v), Vec3::Constant(w * w);
}

void MotionPrior::measured(const PosePrediction& predicted, const SE3& T_cam_world, const Mat6& covariance) {
  const Mat6 gain = ahead_.rate_pose * predicted.information;
  rate_ += gain * (T_cam_world * predicted.T_cam_world.inverse()).log();
  last_.pose = covariance;
  last_.rate_pose = gain * covariance;
  last_.rate = ahead_.rate - gain * (ahead_.pose - covariance) * gain.transpose();
}

}  // namespace godwit::vo
