#include "vo_core/geometry/rotation_fit.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <limits>

namespace godwit::vo {
namespace {
constexpr int kSteps = 4;
constexpr double kMinWidthPx = 0.5;
}  // namespace

bool rotation_residual(const Mat3& R, const Vec2& a, const Vec2& b, double focal_px, Vec2* r, Mat23* J) {
  const Vec3 q = R * Vec3(a.x(), a.y(), 1.0);
  if (!(q.z() > 1e-3)) return false;
  const double u = q.x() / q.z(), v = q.y() / q.z();
  *r = focal_px * (Vec2(u, v) - b);
  *J << -u * v, 1 + u * u, -v, -1 - v * v, u * v, u;
  *J *= focal_px;
  return true;
}

double fit_rotation(std::span<const Vec2> a, std::span<const Vec2> b, double focal_px, std::span<double> scratch,
                    Mat3* R) {
  const std::size_t n = std::min({a.size(), b.size(), scratch.size()});
  if (n == 0) return 0;
  const auto median_residual = [&] {
    for (std::size_t i = 0; i < n; ++i) {
      const Vec3 q = *R * Vec3(a[i].x(), a[i].y(), 1.0);
      scratch[i] = q.z() > 1e-3 ? focal_px * (q.head<2>() / q.z() - b[i]).norm() : std::numeric_limits<double>::max();
    }
    const auto middle = scratch.begin() + static_cast<std::ptrdiff_t>(n / 2);
    std::nth_element(scratch.begin(), middle, scratch.begin() + static_cast<std::ptrdiff_t>(n));
    return *middle;
  };
  double residual = median_residual();
  for (int step = 0; step < kSteps; ++step) {
    const double width = 2.0 * std::min(std::max(residual, kMinWidthPx), 1e6);
    Mat3 A = Mat3::Zero();
    Vec3 g = Vec3::Zero();
    for (std::size_t i = 0; i < n; ++i) {
      Vec2 r;
      Mat23 J;
      if (!rotation_residual(*R, a[i], b[i], focal_px, &r, &J)) continue;
      const double weight = width * width / (width * width + r.squaredNorm());
      A.noalias() += weight * (J.transpose() * J);
      g.noalias() += weight * (J.transpose() * r);
    }
    const Vec3 w = A.ldlt().solve(g);
    if (!w.allFinite()) break;
    *R = so3_exp(-w) * *R;
    residual = median_residual();
  }
  *R = Eigen::Quaterniond(*R).normalized().toRotationMatrix();
  return residual;
}

}  // namespace godwit::vo
