#include "vo_core/map/bundle_adjuster.h"

#include <algorithm>
#include <cmath>

#include "vo_core/map/bundle_problem.h"

namespace godwit::vo {

BundleAdjuster::BundleAdjuster(const CameraModel& camera, const BundleAdjusterOptions& options)
    : problem_(std::make_unique<BundleProblem>(camera, options)) {}
BundleAdjuster::~BundleAdjuster() = default;

BundleReport BundleAdjuster::run(Map* map, int centre) {
  BundleProblem& s = *problem_;
  BundleReport report;
  s.outlier_count = 0;
  s.select(*map, centre);
  report.free_keyframes = s.free_count;
  report.fixed_keyframes = s.pose_count - s.free_count;
  report.points = s.point_count;
  report.observations = s.obs_count;
  if (s.free_count == 0 || s.obs_count < 30) {
    s.free_count = s.point_count = 0;
    return report;
  }
  double lambda = 1e-4;
  double current = s.linearize();
  report.rms_before_px = std::sqrt(current / s.obs_count);
  for (int it = 0; it < s.options.max_iterations; ++it) {
    ++report.iterations;
    const bool solved = s.solve(lambda);
    const double next = solved ? s.cost(s.pose_new, true) : current;
    if (solved && next < current) {
      const double gain = (current - next) / current;
      s.pose = s.pose_new;
      for (int i = 0; i < s.point_count; ++i) s.points[i].p = s.points[i].p_new;
      current = next;
      lambda = std::max(lambda * 0.1, 1e-9);
      if (gain < 1e-3 || it + 1 == s.options.max_iterations) break;
      s.linearize();
    } else {
      lambda = std::min(lambda * 10.0, 1e3);
    }
  }
  report.rms_after_px = std::sqrt(current / s.obs_count);

  for (int f = 0; f < s.free_count; ++f) map->keyframe(s.pose_place[f]).T_kf_world = s.pose[f];
  for (int i = 0; i < s.point_count; ++i) {
    const BundleProblem::Point& q = s.points[i];
    map->point(q.index).p_world = q.p;
    for (int j = q.first; j < q.first + q.count; ++j) {
      const BundleProblem::Obs& o = s.obs[j];
      Vec2 r;
      const bool seen = reprojection_residual(s.camera, o.seen, s.pose[o.pose], q.p, &r);
      if ((!seen || r.norm() > s.options.outlier_px) && s.outlier_count < kMaxOutliers)
        s.outliers[s.outlier_count++] = {o.place, o.feature};
    }
  }
  report.outliers = s.outlier_count;
  return report;
}

int BundleAdjuster::moved_keyframe_count() const {
  return problem_->free_count;
}
int BundleAdjuster::moved_keyframe(int i) const {
  return problem_->pose_place[i];
}
int BundleAdjuster::moved_point_count() const {
  return problem_->point_count;
}
int BundleAdjuster::moved_point(int i) const {
  return problem_->points[i].index;
}
int BundleAdjuster::outlier_count() const {
  return problem_->outlier_count;
}
Observation BundleAdjuster::outlier(int i) const {
  return problem_->outliers[i];
}

}  // namespace godwit::vo
