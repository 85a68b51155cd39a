// A mounting as configurations have it.
#pragma once

#include <Eigen/Core>
#include <array>

#include "vo_core/inertial/inertial_factors.h"

namespace godwit::app {

/// T_body_cam, 4 x 4, row by row [m].
inline std::array<double, 16> mounting_matrix(const vo::CameraMounting& mounting) {
  std::array<double, 16> T{};
  Eigen::Map<Eigen::Matrix<double, 4, 4, Eigen::RowMajor>> M(T.data());
  M.setIdentity();
  M.topLeftCorner<3, 3>() = mounting.R_body_cam;
  M.topRightCorner<3, 1>() = mounting.t_body_cam_m;
  return T;
}

}  // namespace godwit::app
