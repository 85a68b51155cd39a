// The residuals of multi_view_refine.h in one view, point by point in rows, several at a time.
#pragma once

#include <Eigen/Core>
#include <array>

#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

/// One residual (r0, r1) [px] and its derivatives: J[k], the rows' entries by t and then by the rotation; rho0, rho1 by
/// the inverse depth. Real: double, or a vector of numbers. Valid where the point lies before the view.
template <typename Real>
struct InverseDepthTerms {
  Real r0, r1, rho0, rho1;
  std::array<Real, 6> J0, J1;

  /// R, t: of T_view_ref; (x, y, 1) the ray, q0 = R ray; u, v: where the point is, s: focal length over its depth.
  void set(const std::array<Real, 3>& q0, const std::array<Real, 3>& t, const Real& rho, const Real& u, const Real& v,
           const Real& s) {
    const Real zero = s - s, su = s * u, sv = s * v, rho_s = rho * s;
    J0 = {rho_s, zero, zero - rho_s * u, zero - su * q0[1], s * q0[2] + su * q0[0], zero - s * q0[1]};
    J1 = {zero, rho_s, zero - rho_s * v, zero - s * q0[2] - sv * q0[1], sv * q0[0], s * q0[0]};
    rho0 = s * (t[0] - u * t[2]);
    rho1 = s * (t[1] - v * t[2]);
  }
};

/// Points of one view. Each row has room for a multiple of four; what lies beyond `count` there is finite.
struct InverseDepthRows {
  const double *x, *y;  ///< rays in the reference view, z = 1
  const double* rho;    ///< inverse depths
  const double *u, *v;  ///< measured, normalised image plane
  int count = 0;
  double focal_px = 1.0;
};

/// What build_rows() adds to, or fills, point by point; rows as long as those above.
struct InverseDepthPoints {
  double *C, *d;                 ///< by the inverse depth: squares, and with the residual; added to
  double* odds;                  ///< product over the views of 1 + e^2 / width^2; multiplied
  std::array<double*, 6> cross;  ///< pose by inverse depth; filled
};

/// Weighted normal equations of one view's pose, weights width2 / (width2 + e^2); with `points`
/// also what couples pose and points. Returns how many points lie behind the view; they count for nothing. No
/// allocation.
int build_rows(const SE3& T, const InverseDepthRows& in, double width2, Mat6* A, Vec6* b,
               const InverseDepthPoints* points);

}  // namespace godwit::vo
