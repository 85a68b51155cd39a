// How certain the newest keyframe is relative to the others that were adjusted with it (pose_certainty.h): from the
// information at the solution and from what each point's residuals, taken together, pull the poses by (the sandwich
// covariance with points as clusters: Huber 1967; Liang and Zeger, Biometrika 1986).
//
// An error of one point is the same in many pictures: all are aligned with one patch, which lies beside a corner or on
// the edge of a thing. Ten observations of such a point are worth little more than one. Let s_p be the part of the
// normal equations' right-hand side that comes from point p, its own position eliminated. It holds all that the
// point's errors, whatever they have in common, do to the poses; the part of them that a shift of the point explains
// drops out. The poses' errors are x = S^-1 sum s_p, their covariance S^-1 (sum s_c s_c^T) S^-1 with s_c the sum over a
// cluster. Where a thing moves, shines, or lies where the lens bends otherwise, points side by side err together: the
// clusters are the cells of the centre's picture. These are few, and a covariance of few is itself uncertain; so it is
// the mean of that and of the one with each point for itself, as a shrunk covariance is (Ledoit and Wolf 2004).
#include <Eigen/Cholesky>
#include <algorithm>
#include <array>

#include "vo_core/geometry/dense_cholesky.h"
#include "vo_core/geometry/residual_spread.h"
#include "vo_core/map/bundle_problem.h"

namespace godwit::vo {
namespace {

/// What the residuals say of the sandwich as a whole.
struct Sandwich {
  double factor = 1.0;  ///< on its covariance
  bool known = false;
};

// Points in one cell of the picture are one cluster.
int cell_of(const BundleProblem& s, const Vec2& px) {
  const auto place = [](double part, int count) { return std::clamp(static_cast<int>(part * count), 0, count - 1); };
  return place(px.y() / s.camera.height(), BundleProblem::kCellRows) * BundleProblem::kCellColumns +
         place(px.x() / s.camera.width(), BundleProblem::kCellColumns);
}

// Three corrections: the weights' slope (S holds psi / r where the covariance wants the mean derivative of psi), the
// freedom that the poses have taken from the residuals, and what whole bands of a picture
// have in common.
Sandwich correction(const BundleProblem& s) {
  std::array<ResidualSpread, kMaxKeyframes> band;  // by pose
  const double h = s.options.huber_px;
  double weights = 0.0, slopes = 0.0;
  int rows = 0;
  for (int i = 0; i < s.obs_count; ++i) {
    const BundleProblem::Obs& o = s.obs[i];
    if (!o.used) continue;
    const Vec2 r = o.error.cast<double>();
    const double e = r.norm(), w = e <= h ? 1.0 : h / e;
    const int dimensions = o.seen.edgelet ? 1 : 2;
    // Beyond the limit psi has one length: it changes with the direction only.
    const double slope = e <= h ? 1.0 : o.seen.edgelet ? 0.0 : 0.5 * w;
    rows += dimensions;
    weights += dimensions * w;
    slopes += dimensions * slope;
    if (!o.seen.edgelet) band[o.pose].add(w * r, slope, 2, o.seen.px.y() / s.camera.height());
  }
  const int free = rows - 3 * s.point_count, left = free - 6 * s.free_count;
  if (left < 10 || !(slopes > 0.05 * rows)) return {};
  double sums = 0.0, squares = 0.0;
  for (int f = 0; f < s.pose_count; ++f) {
    ResidualSpread& b = band[f];
    b.close_picture();
    sums += b.band_sum_square();
    squares += b.band_square();
  }
  const double ratio = weights / slopes;
  return {ratio * ratio * free / left * ResidualSpread::design_effect(sums, squares), true};
}

// One camera does not know how large the world is. What is said here is said in the map's own units, so the mode that
// scales everything about a keyframe that is held gets the information of a known scale.
void hold_scale(BundleProblem* s) {
  constexpr double kSigma = 1e-3;
  const SE3& held = s->pose[s->pose_count > s->free_count ? s->free_count : s->free_count - 1];
  const Vec3 centre = held.centre();
  Eigen::Map<Eigen::VectorXd> mode(s->rhs.data(), 6 * s->free_count);
  for (int f = 0; f < s->free_count; ++f) {
    mode.segment<3>(6 * f) = s->pose[f] * centre;
    mode.segment<3>(6 * f + 3).setZero();
  }
  const double norm2 = mode.squaredNorm();
  if (!(norm2 > 1e-12)) return;
  const double information = 1.0 / (kSigma * kSigma * norm2 * norm2);
  for (int r = 0; r < 6 * s->free_count; ++r)
    for (int c = 0; c <= r; ++c) s->S[r * BundleProblem::kDim + c] += information * mode(r) * mode(c);
}

constexpr double kStep = 0.05;  // of the centre's median depth: from view to view

// Normal equations of the views, as if each measured all points before the centre as well as their last observation
// did.
bool look_around(BundleProblem* problem, double step) {
  const BundleProblem& s = *problem;
  BundleProblem::Views& v = problem->views;
  v.T_view_world.fill(s.pose[0]);
  for (int k = 1; k < BundleProblem::kViews; ++k) v.T_view_world[k].t(k - 1) -= step;
  std::array<Mat6, BundleProblem::kViews> H;
  H.fill(Mat6::Zero());
  for (auto& by_pose : v.by_pose) std::fill_n(by_pose.begin(), s.free_count, Mat6::Zero());
  for (int i = 0; i < s.point_count; ++i) {
    const BundleProblem::Point& q = s.points[i];
    v.by_point[i].setZero();
    const BundleProblem::Obs* last = nullptr;
    for (int j = q.first; j < q.first + q.count; ++j)
      if (s.obs[j].used) last = &s.obs[j];
    Vec2 px;
    if (last == nullptr || !s.camera.project(s.pose[0] * q.p, &px) || !s.camera.in_image(px, 0.0)) continue;
    const double error = static_cast<double>(last->error.norm());
    const double weight = error <= s.options.huber_px ? 1.0 : s.options.huber_px / error;
    for (int k = 0; k < BundleProblem::kViews; ++k) {
      Vec2 unused;
      Mat23 Jl;
      Mat26 Jx;
      if (!reprojection_residual(s.camera, last->seen, v.T_view_world[k], q.p, &unused, &Jl, &Jx)) continue;
      H[k].noalias() += weight * Jx.transpose() * Jx;
      v.by_point[i].middleRows<6>(6 * k).noalias() = weight * Jx.transpose() * Jl;
    }
    const Eigen::Matrix<double, 6 * BundleProblem::kViews, 3> moved = v.by_point[i].lazyProduct(q.H_inv);
    for (int j = q.first; j < q.first + q.count; ++j) {
      const BundleProblem::Obs& o = s.obs[j];
      if (!o.used || o.pose >= s.free_count) continue;
      for (int k = 0; k < BundleProblem::kViews; ++k)
        v.by_pose[k][o.pose].noalias() += moved.middleRows<6>(6 * k) * o.Hpl.transpose();
    }
  }
  for (int k = 0; k < BundleProblem::kViews; ++k) {
    const Eigen::LDLT<Mat6> ldlt(H[k]);
    if (ldlt.info() != Eigen::Success || !ldlt.isPositive()) return false;
    v.own[k] = ldlt.solve(Mat6::Identity());
    if (!v.own[k].allFinite()) return false;
  }
  return true;
}

}  // namespace

void BundleAdjuster::shares(const Map& map, MapShares* out) {
  BundleProblem& s = *problem_;
  out->centre = 0;
  out->count = 0;
  out->change.setZero();
  const int free = s.free_count, n = 6 * free;
  if (n == 0) return;
  s.linearize();
  const Sandwich sandwich = correction(s);
  if (!sandwich.known) return;
  const Mat6 own = Eigen::LDLT<Mat6>(s.Hpp[0]).solve(Mat6::Identity());
  s.eliminate_points(0.0);
  // Where no keyframe was held, one must be: only what is relative counts.
  if (s.pose_count == free && free > 1)
    for (int i = n - 6; i < n; ++i) s.S[i * BundleProblem::kDim + i] += 1e8;
  hold_scale(&s);
  if (!cholesky_factor(s.S.data(), n, BundleProblem::kDim)) return;
  cholesky_invert_factor(s.S.data(), n, BundleProblem::kDim);
  const auto inverse = [&](int a, int b) -> Mat6& { return s.inverse[a * kMaxFree + b]; };
  for (int a = 0; a < free; ++a)
    for (int b = 0; b < free; ++b)
      inverse(a, b) = cholesky_inverse_block<6>(s.S.data(), n, BundleProblem::kDim, 6 * a, 6 * b);

  BundleProblem::Views& v = s.views;
  const Keyframe& centre = map.keyframe(s.pose_place[0]);
  const double step = kStep * centre.median_depth;
  const bool around = step > 0.0 && look_around(&s, step);

  // Of each free pose, x_0 - Ad x_f less the centre's own noise: exp(x_0) T_0 (exp(x_f) T_f)^-1 = exp(x_0 - Ad x_f)
  // T_0f. In place 0 the centre's own noise itself, in the last that of a keyframe that was held.
  std::array<Mat6, kMaxFree> ad;
  for (int f = 0; f < free; ++f) ad[f] = adjoint(s.pose[0] * s.pose[f].inverse());
  std::array<Mat6, BundleProblem::kViews> ad_view;
  for (int k = 0; k < BundleProblem::kViews; ++k) ad_view[k] = adjoint(s.pose[0] * v.T_view_world[k].inverse());
  for (auto& here : v.here) here.fill(Vec6::Zero());
  v.change.fill(Vec18::Zero());
  std::array<MapShare, kMaxFree + 1> sum;
  const double half = 0.5 * sandwich.factor;
  for (int i = 0; i < s.point_count; ++i) {
    const BundleProblem::Point& q = s.points[i];
    const Vec3 shift = q.H_inv * q.b;
    std::array<Vec6, kMaxFree> x;  // what this point moves the poses by
    for (int f = 0; f < free; ++f) x[f].setZero();
    Vec6 noise = Vec6::Zero();
    for (int j = q.first; j < q.first + q.count; ++j) {
      const BundleProblem::Obs& o = s.obs[j];
      if (!o.used || o.pose >= free) continue;
      const Vec6 pull = o.b - o.Hpl * shift;
      for (int f = 0; f < free; ++f) x[f].noalias() += inverse(f, o.pose) * pull;
      if (o.pose == 0) noise.noalias() = own * o.b;
    }
    Vec2 px;
    const int cell = s.camera.project(s.pose[0] * q.p, &px) ? cell_of(s, px) : 0;
    const Vec6 of_map = x[0] - noise;
    std::array<Vec6, kMaxFree + 1> here;
    here[0] = -noise;
    for (int f = 1; f < free; ++f) here[f] = of_map - ad[f] * x[f];
    here[free] = of_map;
    for (int f = 0; f <= free; ++f) {
      v.here[cell][f] += here[f];
      sum[f].covariance.noalias() += half * here[f] * here[f].transpose();
    }
    if (!around) continue;
    // All points move with the poses, this one by itself, too, and the views with the points.
    std::array<Vec6, BundleProblem::kViews> view;
    for (int k = 0; k < BundleProblem::kViews; ++k) {
      Vec6 moved = -v.by_point[i].middleRows<6>(6 * k) * shift;
      for (int f = 0; f < free; ++f) moved.noalias() += v.by_pose[k][f] * x[f];
      view[k].noalias() = ad_view[k] * (v.own[k] * moved);
    }
    Vec18 change;
    for (int k = 1; k < BundleProblem::kViews; ++k) change.segment<6>(6 * (k - 1)) = (view[k] - view[0]) / step;
    v.change[cell] += change;
    out->change.noalias() += half * change * change.transpose();
    for (int f = 0; f <= free; ++f) sum[f].with_change.noalias() += half * here[f] * change.transpose();
  }
  for (int c = 0; c < BundleProblem::kCells; ++c) {
    out->change.noalias() += half * v.change[c] * v.change[c].transpose();
    for (int f = 0; f <= free; ++f) {
      sum[f].covariance.noalias() += half * v.here[c][f] * v.here[c][f].transpose();
      sum[f].with_change.noalias() += half * v.here[c][f] * v.change[c].transpose();
    }
  }
  const auto add = [&](int pose, int place) {
    MapShare share = sum[place];
    share.keyframe_id = map.keyframe(s.pose_place[pose]).id;
    if (out->count < MapShares::kMax && share.covariance.allFinite()) out->share[out->count++] = share;
  };
  for (int f = 0; f < s.pose_count; ++f) {
    if (f < free)
      add(f, f);
    else if (map.keyframe(s.pose_place[f]).id == 1)
      add(f, free);
  }
  out->centre = centre.id;
  out->median_depth = centre.median_depth;
}

}  // namespace godwit::vo
