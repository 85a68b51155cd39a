#include "vo_core/tracking/pose_optimizer.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <hwy/highway.h>

#include "hal/rt/count.h"
#include "vo_core/geometry/residual_spread.h"
#include "vo_core/map/map_exchange.h"

namespace godwit::vo {
namespace hn = hwy::HWY_NAMESPACE;
namespace {
// A pose has six unknowns; a prior knows them all, and what is left is that the median of the errors means something.
constexpr int kFewest = 10, kFewestBesidePrior = 6;
constexpr double kFirstScale = 10.0, kMinScale = 0.5;
constexpr double kSmallStep = 0.01;  // of the pose's own sigma: what is left to gain then is below its noise
constexpr int kRoughSteps = 3;       // with the spread that the first pose leaves; from then on with that of the last

// The measurements coordinate by coordinate, several at a time. Half of a frame's pose was spent on them one by one.
class Rows {
 public:
  Rows(const CameraModel& camera, std::span<const PoseMeasurement> measurements)
      : camera_(camera), count_(rt::count_of(measurements)) {
    for (int i = 0; i < count_; ++i) {
      const PoseMeasurement& m = measurements[i];
      const bool edgelet = m.type == FeatureType::kEdgelet;
      world_[0][i] = m.p_world.x();
      world_[1][i] = m.p_world.y();
      world_[2][i] = m.p_world.z();
      px_[0][i] = m.px.x();
      px_[1][i] = m.px.y();
      // What counts of a residual: of an edgelet's what lies along its gradient, and nothing across.
      part_[0][i] = edgelet ? m.gradient.x() : 1.0;
      part_[1][i] = edgelet ? m.gradient.y() : 0.0;
      part_[2][i] = edgelet ? 0.0 : 1.0;
      per_sigma_[i] = 1.0 / m.sigma_px;
    }
    for (int i = count_; i < padded(); ++i) {
      for (auto& row : world_) row[i] = 0.0;
      for (auto& row : px_) row[i] = 0.0;
      for (auto& row : part_) row[i] = 0.0;
      per_sigma_[i] = 0.0;
    }
  }

  /// Residuals at this pose, and in sigmas; -1: cannot be seen.
  void look(const SE3& T) {
    const hn::CappedTag<double, 4> d;
    const auto at = [&](const double* p, int i) { return hn::LoadU(d, p + i); };
    const int lanes = static_cast<int>(hn::Lanes(d)), n = padded();
    for (int row = 0; row < 3; ++row) {
      const auto a = hn::Set(d, T.R(row, 0)), b = hn::Set(d, T.R(row, 1)), c = hn::Set(d, T.R(row, 2)),
                 t = hn::Set(d, T.t(row));
      for (int i = 0; i < n; i += lanes)
        hn::StoreU(a * at(world_[0], i) + b * at(world_[1], i) + c * at(world_[2], i) + t, d, camera_point_[row] + i);
    }
    double* const J[6] = {J_[0], J_[1], J_[2], J_[3], J_[4], J_[5]};
    camera_.project(n,
                    CameraModel::Rows<double>{camera_point_[0], camera_point_[1], camera_point_[2], u_, v_, seen_, J});
    for (int i = 0; i < n; i += lanes) {
      const auto du = at(px_[0], i) - at(u_, i), dv = at(px_[1], i) - at(v_, i);
      const auto r0 = at(part_[0], i) * du + at(part_[1], i) * dv, r1 = at(part_[2], i) * dv;
      hn::StoreU(r0, d, residual_[0] + i);
      hn::StoreU(r1, d, residual_[1] + i);
      const auto error = hn::Sqrt(r0 * r0 + r1 * r1) * at(per_sigma_, i);
      const auto seen = hn::Gt(at(seen_, i), hn::Zero(d));
      hn::StoreU(hn::IfThenElse(seen, error, hn::Set(d, -1.0)), d, error_ + i);
      // What is no number must not become one of the sums by a weight of zero.
      for (auto& row : camera_point_) hn::StoreU(hn::IfThenElseZero(seen, at(row, i)), d, row + i);
    }
  }

  /// Weights by the last look, Tukey's, with this many sigmas for one; or one by one.
  void weigh_tukey(double scale) {
    const hn::CappedTag<double, 4> d;
    const auto per = hn::Set(d, 1.0 / (kTukey * scale)), one = hn::Set(d, 1.0);
    for (int i = 0; i < padded(); i += static_cast<int>(hn::Lanes(d))) {
      const auto error = hn::LoadU(d, error_ + i);
      const auto x = error * per;
      const auto v = hn::Max(one - x * x, hn::Zero(d));
      hn::StoreU(hn::IfThenElseZero(hn::Ge(error, hn::Zero(d)), v * v), d, weight_ + i);
    }
  }
  void weigh(int i, double weight) { weight_[i] = weight; }
  /// For the left twist of T_cam_world, at the last look.
  void normal_equations(Mat6* H, Vec6* b) const {
    const hn::CappedTag<double, 4> d;
    const auto at = [&](const double* p, int i) { return hn::LoadU(d, p + i); };
    using V = hn::Vec<decltype(d)>;
    std::array<V, 21> sum_H;
    std::array<V, 6> sum_b;
    sum_H.fill(hn::Zero(d));
    sum_b.fill(hn::Zero(d));
    for (int i = 0; i < padded(); i += static_cast<int>(hn::Lanes(d))) {
      const V x = at(camera_point_[0], i), y = at(camera_point_[1], i), z = at(camera_point_[2], i);
      const V per = at(per_sigma_, i);
      const V w = at(weight_, i) * per * per;
      const auto add = [&](const V& j0, const V& j1, const V& j2, const V& r) {
        // d residual / d twist: minus the Jacobian by the point, and that times the point's cross product.
        const std::array<V, 6> J{hn::Neg(j0),     hn::Neg(j1),     hn::Neg(j2),
                                 j1 * z - j2 * y, j2 * x - j0 * z, j0 * y - j1 * x};
        int k = 0;
        for (int row = 0; row < 6; ++row) {
          const V weighted = w * J[row];
          sum_b[row] = hn::NegMulAdd(weighted, r, sum_b[row]);
          for (int column = row; column < 6; ++column, ++k) sum_H[k] = hn::MulAdd(weighted, J[column], sum_H[k]);
        }
      };
      const V p0 = at(part_[0], i), p1 = at(part_[1], i), p2 = at(part_[2], i);
      add(p0 * at(J_[0], i) + p1 * at(J_[3], i), p0 * at(J_[1], i) + p1 * at(J_[4], i),
          p0 * at(J_[2], i) + p1 * at(J_[5], i), at(residual_[0], i));
      add(p2 * at(J_[3], i), p2 * at(J_[4], i), p2 * at(J_[5], i), at(residual_[1], i));
    }
    int k = 0;
    for (int row = 0; row < 6; ++row) {
      (*b)(row) = hn::GetLane(hn::SumOfLanes(d, sum_b[row]));
      for (int column = row; column < 6; ++column, ++k)
        (*H)(row, column) = (*H)(column, row) = hn::GetLane(hn::SumOfLanes(d, sum_H[k]));
    }
  }

  double error(int i) const { return error_[i]; }  ///< [sigmas]; -1: cannot be seen
  double squared_px(int i) const { return residual_[0][i] * residual_[0][i] + residual_[1][i] * residual_[1][i]; }

 private:
  int padded() const { return CameraModel::row_room(count_); }
  using Row = double[CameraModel::row_room(kMaxFrameFeatures)];

  const CameraModel& camera_;
  int count_;
  Row world_[3], px_[2], part_[3], per_sigma_;
  Row camera_point_[3], u_, v_, seen_, J_[6], residual_[2], error_, weight_;
};
}  // namespace

double chi_square_limit(int freedom) {
  constexpr double kNormal999 = 3.0902;
  const double n = std::max(freedom, 1), v = 2.0 / (9.0 * n), root = 1.0 - v + kNormal999 * std::sqrt(v);
  return n * root * root * root;
}

bool pose_residual(const CameraModel& camera, const SE3& T_cam_world, const PoseMeasurement& m, Vec2* residual,
                   Mat26* J) {
  const Vec3 p = T_cam_world * m.p_world;
  Vec2 px;
  Mat23 Jp;
  if (!camera.project(p, &px, J ? &Jp : nullptr)) return false;
  *residual = m.px - px;
  if (J) {
    J->leftCols<3>() = -Jp;
    J->rightCols<3>() = Jp * skew(p);
  }
  if (m.type == FeatureType::kEdgelet) {
    const double along = m.gradient.dot(*residual);
    *residual = Vec2(along, 0.0);
    if (J) {
      J->row(0) = m.gradient.transpose() * *J;
      J->row(1).setZero();
    }
  }
  return true;
}

PoseOptimizerResult optimize_pose(const CameraModel& camera, const PoseOptimizerOptions& options,
                                  std::span<PoseMeasurement> measurements, SE3* T_cam_world,
                                  const PosePrediction& prior) {
  PoseOptimizerResult result;
  const int n = std::min(rt::count_of(measurements), kMaxFrameFeatures);
  result.measurements = n;
  const int fewest = prior.known ? kFewestBesidePrior : kFewest;
  if (n < fewest) return result;
  Rows rows(camera, measurements.first(n));
  std::array<float, kMaxFrameFeatures> errors;
  SE3 T = *T_cam_world;
  double scale = 1.0;
  const auto measure_scale = [&](double most) {
    int count = 0;
    for (int i = 0; i < n; ++i) {
      if (rows.error(i) < 0.0) continue;
      // Median of a normal error's size: of two coordinates 1.1774 sigma, of an edgelet's one 0.6745.
      const double median = measurements[i].type == FeatureType::kEdgelet ? 0.6745 : 1.1774;
      errors[count++] = static_cast<float>(rows.error(i) / median);
    }
    if (count < fewest) return false;
    std::nth_element(errors.begin(), errors.begin() + count / 2, errors.begin() + count);
    result.sigma_scale = static_cast<double>(errors[count / 2]);
    scale = std::clamp(result.sigma_scale, kMinScale, most);
    return true;
  };
  rows.look(T);
  if (!measure_scale(kFirstScale)) return result;
  Mat6 H;
  Vec6 b;
  for (int it = 0; it < options.max_iterations; ++it) {
    rows.weigh_tukey(scale);
    rows.normal_equations(&H, &b);
    if (prior.known) {
      const Mat6 information = scale * scale * prior.correlated * prior.information;
      H += information;
      b -= information * (T * prior.T_cam_world.inverse()).log();
    }
    Eigen::LDLT<Mat6> ldlt(H);
    if (ldlt.info() != Eigen::Success || !ldlt.isPositive()) return result;
    const Vec6 dx = ldlt.solve(b);
    if (!dx.allFinite()) return result;
    T = SE3::exp(dx) * T;
    rows.look(T);
    if (it == kRoughSteps - 1 && !measure_scale(options.max_scale)) return result;
    if (it >= kRoughSteps && dx.dot(b) < kSmallStep * kSmallStep) break;
  }
  // Final classification and information at the solution, inliers only.
  double sum_px = 0.0;
  for (int i = 0; i < n; ++i) {
    PoseMeasurement& m = measurements[i];
    const double e = rows.error(i);
    m.inlier = e >= 0.0 && e <= options.outlier_sigma;
    rows.weigh(i, m.inlier ? 1.0 : 0.0);
    if (!m.inlier) continue;
    m.error = e;
    ++result.inliers;
    result.chi_square += e * e;
    result.freedom += m.type == FeatureType::kEdgelet ? 1 : 2;
    sum_px += rows.squared_px(i);
  }
  if (result.inliers < fewest) return result;
  rows.normal_equations(&H, &b);
  Eigen::LDLT<Mat6> ldlt(H);
  if (ldlt.info() != Eigen::Success || !ldlt.isPositive()) return result;
  result.weight_scale = scale;
  result.freedom -= 6;
  result.rms_px = std::sqrt(sum_px / result.inliers);
  const double wider = std::max(1.0, result.chi_square / result.freedom);
  result.covariance = ldlt.solve(Mat6::Identity()) * wider;
  if (!result.covariance.allFinite()) return result;
  const Mat6 together = H / (wider * prior.correlated) + prior.information;
  result.with_prior = Eigen::LDLT<Mat6>(together).solve(Mat6::Identity());
  T.normalize();
  *T_cam_world = T;
  result.ok = true;
  return result;
}

bool judge_residual(const CameraModel& camera, const SE3& T_cam_world, const PoseMeasurement& m, double weight_scale,
                    JudgedResidual* out) {
  Vec2 r;
  Mat26 J;
  if (!pose_residual(camera, T_cam_world, m, &r, &J)) return false;
  const double inv_sigma = 1.0 / m.sigma_px, u = r.norm() * inv_sigma / (weight_scale * kTukey);
  *out = {r, J, inv_sigma, u * u};
  return true;
}

}  // namespace godwit::vo
