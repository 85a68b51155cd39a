// How certain the newest keyframe is relative to the others that were adjusted with it (pose_certainty.h): from the
// information at the solution and from what each point's residuals, taken together, pull the poses by (the sandwich
// covariance with points as clusters: Huber 1967; Liang and Zeger, Biometrika 1986).
//
// An error of one point is the same in many pictures: all are aligned with one patch, which lies beside a corner or on
// the edge of a thing. Ten observations of such a point are worth little more than one. Let s_p be the part of the
// normal equations' right-hand side that comes from point p, its own position eliminated. It holds all that the
// point's errors, whatever they have in common, do to the poses; the part of them that a shift of the point explains
// drops out. The poses' errors are x = S^-1 sum s_p, their covariance S^-1 (sum s_p s_p^T) S^-1.
#include <Eigen/Cholesky>
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

// Three corrections: the weights' slope (S holds psi / r where the covariance wants the mean derivative of psi), the
// freedom that the poses have taken from the residuals, and what neighbours in a picture have in common.
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

}  // namespace

void BundleAdjuster::shares(const Map& map, MapShares* out) {
  BundleProblem& s = *problem_;
  out->centre = 0;
  out->count = 0;
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

  // Of each free pose, x_0 - Ad x_f less the centre's own noise: exp(x_0) T_0 (exp(x_f) T_f)^-1 = exp(x_0 - Ad x_f)
  // T_0f. In place 0 the centre's own noise itself.
  std::array<Mat6, kMaxFree + 1> sum, ad;
  sum.fill(Mat6::Zero());
  for (int f = 1; f < free; ++f) ad[f] = adjoint(s.pose[0] * s.pose[f].inverse());
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
    sum[0].noalias() += noise * noise.transpose();
    const Vec6 of_map = x[0] - noise;
    for (int f = 1; f < free; ++f) {
      const Vec6 u = of_map - ad[f] * x[f];
      sum[f].noalias() += u * u.transpose();
    }
    // Of a keyframe that was held.
    sum[free].noalias() += of_map * of_map.transpose();
  }
  const auto add = [&](int pose, int place) {
    const Mat6 share = sandwich.factor * sum[place];
    if (out->count < MapShares::kMax && share.allFinite())
      out->share[out->count++] = {map.keyframe(s.pose_place[pose]).id, share};
  };
  for (int f = 0; f < s.pose_count; ++f) {
    if (f < free)
      add(f, f);
    else if (map.keyframe(s.pose_place[f]).id == 1)
      add(f, free);
  }
  out->centre = map.keyframe(s.pose_place[0]).id;
}

}  // namespace godwit::vo
