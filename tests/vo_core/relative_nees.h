// Errors of relative poses over their stated covariance: what one camera can know, rotation and direction.
#pragma once

#include <Eigen/Cholesky>

#include "vo_core/geometry/geometry.h"

namespace godwit::vo::test {

/// Rotation (3) and direction of the way (2): how long it is, one camera does not know.
struct RelativeNees {
  double squared = 0.0;
  int freedom = 0;

  /// C: of the left twist of `told`, T_cam_ref. The NEES a degree of freedom of this one is returned.
  double add(const SE3& told, const SE3& truth, const Mat6& C) {
    const Vec3 d = told.t.normalized(), first = d.unitOrthogonal(), second = d.cross(first);
    Eigen::Matrix<double, 5, 1> error;
    error.head<3>() = so3_log(truth.R * told.R.transpose());
    error.tail<2>() << first.dot(truth.t.normalized()), second.dot(truth.t.normalized());
    Mat23 B;
    B << first.transpose(), second.transpose();
    Eigen::Matrix<double, 5, 6> J = Eigen::Matrix<double, 5, 6>::Zero();
    J.topRightCorner<3, 3>().setIdentity();
    J.bottomLeftCorner<2, 3>() = B / told.t.norm();
    J.bottomRightCorner<2, 3>() = -B * skew(d);
    const Eigen::Matrix<double, 5, 5> P = J * C * J.transpose();
    const double one = error.dot(P.ldlt().solve(error));
    squared += one;
    freedom += 5;
    return one / 5.0;
  }
  double mean() const { return squared / freedom; }
};

}  // namespace godwit::vo::test
