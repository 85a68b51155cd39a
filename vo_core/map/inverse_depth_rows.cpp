#include "vo_core/map/inverse_depth_rows.h"

#include <hwy/highway.h>

namespace godwit::vo {
namespace hn = hwy::HWY_NAMESPACE;

int build_rows(const SE3& T, const InverseDepthRows& in, double width2, Mat6* A, Vec6* b,
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
