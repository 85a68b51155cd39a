// The residuals of multi_view_refine.h in one view, point by point in rows, several at a time. Header-only, inlined
// into its one user.
#pragma once

#include <Eigen/Core>
#include <array>
#include <hwy/highway.h>

#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

namespace hn = hwy::HWY_NAMESPACE;

/// One residual (r0, r1) [px] and its derivatives: J[k], the rows' entries by t and then by the rotation; rho0, rho1 by
/// the inverse depth. Real: double, or a vector of numbers. Where the point lies before the view: InverseDepthResidual.
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

/// Points of one view in rows of kRoom, what lies beyond `count` finite.
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

/// Weighted normal equations of one view's pose (lower triangle of A), weights width2 / (width2 + e^2); with `points`
/// also what couples pose and points. Returns how many points lie behind the view; they count for nothing. No
/// allocation.
inline int build_rows(const SE3& T, const InverseDepthRows& in, double width2, Mat6* A, Vec6* b,
                      const InverseDepthPoints* points) {
  const hn::CappedTag<double, 4> d;
  using V = hn::Vec<decltype(d)>;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const auto at = [&](const double* p, int i) { return hn::LoadU(d, p + i); };
  const auto set = [&](double value) { return hn::Set(d, value); };
  const V one = set(1.0), focal = set(in.focal_px), width = set(width2), per_width = set(1.0 / width2);
  const std::array<V, 3> t{set(T.t(0)), set(T.t(1)), set(T.t(2))};
  std::array<V, 21> sum_A;
  std::array<V, 6> sum_b;
  sum_A.fill(hn::Zero(d));
  sum_b.fill(hn::Zero(d));
  int behind = 0;
  for (int i = 0; i < in.count; i += lanes) {
    const V x = at(in.x, i), y = at(in.y, i), rho = at(in.rho, i);
    std::array<V, 3> q0;
    for (int row = 0; row < 3; ++row)
      q0[row] = hn::MulAdd(set(T.R(row, 0)), x, hn::MulAdd(set(T.R(row, 1)), y, set(T.R(row, 2))));
    const V qz = hn::MulAdd(rho, t[2], q0[2]);
    const auto there = hn::FirstN(d, static_cast<std::size_t>(in.count - i));
    const auto front = hn::And(there, hn::Gt(qz, set(1e-3)));
    behind += static_cast<int>(hn::CountTrue(d, there)) - static_cast<int>(hn::CountTrue(d, front));
    const V iz = hn::Div(one, hn::IfThenElse(front, qz, one));
    const V u = hn::MulAdd(rho, t[0], q0[0]) * iz, v = hn::MulAdd(rho, t[1], q0[1]) * iz;
    InverseDepthTerms<V> e;
    e.r0 = focal * (u - at(in.u, i));
    e.r1 = focal * (v - at(in.v, i));
    e.set(q0, t, rho, u, v, focal * iz);
    const V e2 = e.r0 * e.r0 + e.r1 * e.r1;
    const V w = hn::IfThenElseZero(front, hn::Div(width, width + e2));
    int k = 0;
    for (int row = 0; row < 6; ++row) {
      const V a = w * e.J0[row], c = w * e.J1[row];
      sum_b[row] = hn::MulAdd(a, e.r0, hn::MulAdd(c, e.r1, sum_b[row]));
      for (int column = 0; column <= row; ++column, ++k)
        sum_A[k] = hn::MulAdd(a, e.J0[column], hn::MulAdd(c, e.J1[column], sum_A[k]));
      if (points) hn::StoreU(hn::MulAdd(a, e.rho0, c * e.rho1), d, points->cross[row] + i);
    }
    if (!points) continue;
    const V odds = hn::IfThenElse(front, hn::MulAdd(e2, per_width, one), one);
    hn::StoreU(at(points->odds, i) * odds, d, points->odds + i);
    hn::StoreU(hn::MulAdd(w, e.rho0 * e.rho0 + e.rho1 * e.rho1, at(points->C, i)), d, points->C + i);
    hn::StoreU(hn::MulAdd(w, e.rho0 * e.r0 + e.rho1 * e.r1, at(points->d, i)), d, points->d + i);
  }
  int k = 0;
  for (int row = 0; row < 6; ++row) {
    (*b)(row) = hn::GetLane(hn::SumOfLanes(d, sum_b[row]));
    for (int column = 0; column <= row; ++column, ++k)
      (*A)(row, column) = (*A)(column, row) = hn::GetLane(hn::SumOfLanes(d, sum_A[k]));
  }
  return behind;
}

}  // namespace godwit::vo
