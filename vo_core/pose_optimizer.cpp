#include "vo_core/pose_optimizer.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>

#include "vo_core/map_exchange.h"

namespace godwit::vo {
namespace {
// Tukey's biweight with the usual constant for 95 % efficiency at the normal distribution.
constexpr double kTukey = 4.6851;
double tukey_weight(double x) {
  const double u = x / kTukey;
  const double v = 1.0 - u * u;
  return v > 0.0 ? v * v : 0.0;
}
}  // namespace

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
                                  std::span<PoseMeasurement> measurements, SE3* T_cam_world) {
  PoseOptimizerResult result;
  const int n = static_cast<int>(std::min<std::size_t>(measurements.size(), kMaxFrameFeatures));
  result.measurements = n;
  if (n < 10) return result;
  std::array<float, kMaxFrameFeatures> errors;
  SE3 T = *T_cam_world;
  double scale = 1.0;
  const auto measure_scale = [&] {
    int count = 0;
    for (int i = 0; i < n; ++i) {
      Vec2 r;
      if (pose_residual(camera, T, measurements[i], &r, nullptr))
        errors[count++] = static_cast<float>(r.norm() / measurements[i].sigma_px);
    }
    if (count < 10) return false;
    std::nth_element(errors.begin(), errors.begin() + count / 2, errors.begin() + count);
    // Median of a two-dimensional normal error's norm is 1.1774 sigma.
    scale = std::clamp(static_cast<double>(errors[count / 2]) / 1.1774, 0.1, 10.0);
    return true;
  };
  if (!measure_scale()) return result;
  Mat6 H = Mat6::Zero();
  for (int it = 0; it < options.max_iterations; ++it) {
    H.setZero();
    Vec6 b = Vec6::Zero();
    for (int i = 0; i < n; ++i) {
      Vec2 r;
      Mat26 J;
      if (!pose_residual(camera, T, measurements[i], &r, &J)) continue;
      const double s = measurements[i].sigma_px;
      const double w = tukey_weight(r.norm() / (s * scale)) / (s * s);
      if (w == 0.0) continue;
      H.noalias() += w * (J.transpose() * J);
      b.noalias() -= w * (J.transpose() * r);
    }
    Eigen::LDLT<Mat6> ldlt(H);
    if (ldlt.info() != Eigen::Success || !ldlt.isPositive()) return result;
    const Vec6 dx = ldlt.solve(b);
    if (!dx.allFinite()) return result;
    T = SE3::exp(dx) * T;
    if (it == 2 && !measure_scale()) return result;
    if (it > 2 && dx.cwiseAbs().maxCoeff() < 1e-7) break;
  }
  // Final classification and information at the solution, inliers only.
  H.setZero();
  double sum_sq = 0.0, sum_w = 0.0;
  for (int i = 0; i < n; ++i) {
    PoseMeasurement& m = measurements[i];
    Vec2 r;
    Mat26 J;
    m.inlier = false;
    if (!pose_residual(camera, T, m, &r, &J)) continue;
    const double e = r.norm() / m.sigma_px;
    if (e > options.outlier_sigma * std::max(scale, 0.35)) continue;
    m.inlier = true;
    ++result.inliers;
    const double w = 1.0 / (m.sigma_px * m.sigma_px);
    H.noalias() += w * (J.transpose() * J);
    sum_sq += e * e;
    sum_w += w * m.sigma_px * m.sigma_px;
  }
  if (result.inliers < 10) return result;
  Eigen::LDLT<Mat6> ldlt(H);
  if (ldlt.info() != Eigen::Success || !ldlt.isPositive()) return result;
  result.sigma_scale = scale;
  result.rms_px = std::sqrt(sum_sq / sum_w);
  result.covariance = ldlt.solve(Mat6::Identity()) * (scale * scale);
  if (!result.covariance.allFinite()) return result;
  T.normalize();
  *T_cam_world = T;
  result.ok = true;
  return result;
}

}  // namespace godwit::vo
