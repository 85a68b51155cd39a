#include "vo_core/map/structure_optimizer.h"

#include <Eigen/Cholesky>
#include <cmath>

#include "vo_core/geometry/reprojection.h"

namespace godwit::vo {

double optimize_structure(const CameraModel& camera, const Map& map, const MapPoint& point, int max_iterations,
                          Vec3* p_world) {
  Vec3 p = *p_world, p_old = p;
  double error_old = -1.0;
  for (int it = 0; it <= max_iterations; ++it) {
    Mat3 H = Mat3::Zero();
    Vec3 b = Vec3::Zero();
    double sum = 0.0;
    int n = 0;
    for (int i = 0; i < point.observation_count; ++i) {
      const Keyframe& kf = map.keyframe(point.observations[i].keyframe);
      const KeyframeFeature& f = kf.features[point.observations[i].feature];
      const ImageObservation seen{f.px_global.cast<double>(), f.gradient.cast<double>(), 1.0 / (1 << f.level),
                                  f.type == FeatureType::kEdgelet};
      Vec2 r;
      Mat23 J;
      if (!reprojection_residual(camera, seen, kf.T_kf_world, p, &r, &J)) continue;
      sum += r.squaredNorm();
      ++n;
      H.noalias() += J.transpose() * J;
      b.noalias() += J.transpose() * r;
    }
    if (n == 0) return -1.0;
    const double error = std::sqrt(sum / n);
    if (error_old >= 0.0 && error > error_old) {
      *p_world = p_old;
      return error_old;
    }
    p_old = p;
    error_old = error;
    if (it == max_iterations) break;
    H.diagonal().array() += 1e-9 * H.trace();
    const Vec3 dp = H.ldlt().solve(b);
    if (!dp.allFinite()) break;
    p += dp;
    if (dp.norm() < 1e-7) break;
  }
  *p_world = p_old;
  return error_old;
}

}  // namespace godwit::vo
