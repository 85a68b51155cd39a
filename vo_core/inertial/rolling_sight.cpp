#include "vo_core/inertial/rolling_sight.h"

#include <algorithm>
#include <cmath>

#include "vo_core/geometry/dense_cholesky.h"

namespace godwit::vo {
namespace {

/// No picture is surer of itself than this share of what vision errs by over all (InertialModel::rotation_sigma,
/// position_sigma): with less, and no shaking, rounding would decide.
constexpr double kLeastOwn = 1e-2;

/// How much of what turns and places have in common counts: errors alike to the last bit would leave nothing to err by.
constexpr double kTogether = 0.999;

bool inverse_of(const Mat6& C, Mat6* inverse) {
  double L[36];
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j) L[6 * i + j] = C(i, j);
  if (!cholesky_factor(L, 6, 6)) return false;
  for (int column = 0; column < 6; ++column) {
    double x[6] = {};
    x[column] = 1;
    cholesky_substitute(L, 6, 6, x);
    for (int i = 0; i < 6; ++i) (*inverse)(i, column) = x[i];
  }
  *inverse = (0.5 * (*inverse + inverse->transpose())).eval();
  return inverse->allFinite();
}

Mat6 correlation_of(const Mat6& C) {
  if (!(C.diagonal().minCoeff() > 0)) return Mat6::Identity();
  const Vec6 inverse_sigma = C.diagonal().cwiseSqrt().cwiseInverse();
  Mat6 out = kTogether * (inverse_sigma.asDiagonal() * C * inverse_sigma.asDiagonal());
  out.diagonal().setOnes();
  return out;
}

}  // namespace

Mat6 turn_and_place(const Mat6& twist, const Mat3& R_map_cam) {
  // Both err against the twist: what they have in common stays as it is.
  Mat6 to_map = Mat6::Zero();
  to_map.topRightCorner<3, 3>() = to_map.bottomLeftCorner<3, 3>() = R_map_cam;
  return to_map * twist * to_map.transpose();
}

void see_rolling(const VisualPose& pose, const Mat3& R_body_cam, const Vec3& mean_turn, const InertialModel& model,
                 VisionSight* sight) {
  sight->R_map_cam = sight->R_map_cam * so3_exp(-(R_body_cam.transpose() * mean_turn));
  Mat6 own = turn_and_place(pose.own_covariance, pose.T_map_cam.R);
  if (!(own.diagonal().minCoeff() > 0)) return;
  const double least_turn = kLeastOwn * model.rotation_sigma, least_place = kLeastOwn * model.position_sigma;
  own.diagonal().head<3>().array() += least_turn * least_turn;
  own.diagonal().tail<3>().array() += std::pow(least_place * sight->depth, 2);
  Mat6 information;
  if (!inverse_of(own, &information)) return;
  sight->own_information = information;
  sight->walk_correlation = correlation_of(turn_and_place(pose.relative_covariance, pose.T_map_cam.R));
}

}  // namespace godwit::vo
