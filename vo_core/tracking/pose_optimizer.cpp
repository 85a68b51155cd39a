#include "vo_core/tracking/pose_optimizer.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>

#include "vo_core/geometry/residual_spread.h"
#include "vo_core/map/map_exchange.h"

namespace godwit::vo {
namespace {
constexpr double kFirstScale = 10.0, kMinScale = 0.5;
constexpr double kSmallStep = 0.01;  // of the pose's own sigma: what is left to gain then is below its noise
constexpr int kRoughSteps = 3;       // with the spread that the first pose leaves; from then on with that of the last
double tukey_weight(double x) {
  const double u = x / kTukey;
  const double v = 1.0 - u * u;
  return v > 0.0 ? v * v : 0.0;
}
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
                                  std::span<PoseMeasurement> measurements, SE3* T_cam_world) {
  PoseOptimizerResult result;
  const int n = static_cast<int>(std::min<std::size_t>(measurements.size(), kMaxFrameFeatures));
  result.measurements = n;
  if (n < 10) return result;
  std::array<float, kMaxFrameFeatures> errors;
  SE3 T = *T_cam_world;
  double scale = 1.0;
  const auto measure_scale = [&](double most) {
    int count = 0;
    for (int i = 0; i < n; ++i) {
      Vec2 r;
      const PoseMeasurement& m = measurements[i];
      if (!pose_residual(camera, T, m, &r, nullptr)) continue;
      // Median of a normal error's size: of two coordinates 1.1774 sigma, of an edgelet's one 0.6745.
      const double median = m.type == FeatureType::kEdgelet ? 0.6745 : 1.1774;
      errors[count++] = static_cast<float>(r.norm() / (m.sigma_px * median));
    }
    if (count < 10) return false;
    std::nth_element(errors.begin(), errors.begin() + count / 2, errors.begin() + count);
    result.sigma_scale = static_cast<double>(errors[count / 2]);
    scale = std::clamp(result.sigma_scale, kMinScale, most);
    return true;
  };
  if (!measure_scale(kFirstScale)) return result;
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
    if (it == kRoughSteps - 1 && !measure_scale(options.max_scale)) return result;
    if (it >= kRoughSteps && dx.dot(b) < kSmallStep * kSmallStep) break;
  }
  // Final classification and information at the solution, inliers only.
  H.setZero();
  double sum_px = 0.0;
  for (int i = 0; i < n; ++i) {
    PoseMeasurement& m = measurements[i];
    Vec2 r;
    Mat26 J;
    m.inlier = false;
    if (!pose_residual(camera, T, m, &r, &J)) continue;
    const double e = r.norm() / m.sigma_px;
    if (e > options.outlier_sigma) continue;
    m.inlier = true;
    ++result.inliers;
    const double w = 1.0 / (m.sigma_px * m.sigma_px);
    H.noalias() += w * (J.transpose() * J);
    result.chi_square += e * e;
    result.freedom += m.type == FeatureType::kEdgelet ? 1 : 2;
    sum_px += r.squaredNorm();
  }
  if (result.inliers < 10) return result;
  Eigen::LDLT<Mat6> ldlt(H);
  if (ldlt.info() != Eigen::Success || !ldlt.isPositive()) return result;
  result.weight_scale = scale;
  result.freedom -= 6;
  result.rms_px = std::sqrt(sum_px / result.inliers);
  const double wider = std::max(1.0, result.chi_square / result.freedom);
  result.covariance = ldlt.solve(Mat6::Identity()) * wider;
  if (!result.covariance.allFinite()) return result;
  T.normalize();
  *T_cam_world = T;
  result.ok = true;
  return result;
}

}  // namespace godwit::vo
