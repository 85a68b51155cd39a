#include "vo_core/inertial/metric_map.h"

#include <algorithm>
#include <cmath>

namespace godwit::vo {

void VisionStray::judge(const VisualPose& pose) {
  if (pose.map_id != map_id_) told_ = taken_back_ = {};
  map_id_ = pose.map_id;
  const double since_s = rt::to_seconds(pose.t_ns - t_judged_ns_), strayed_s = rt::to_seconds(options_.strayed_ns);
  t_judged_ns_ = pose.t_ns;
  told_.forget(since_s, rt::to_seconds(options_.memory_ns));
  taken_back_.forget(since_s, strayed_s);
  const double depth2 = std::max(1e-12, pose.median_depth * pose.median_depth);
  if (pose.map_moved)
    taken_back_.hear(pose.turned_by.squaredNorm() / (3 * strayed_s),
                     pose.moved_by.squaredNorm() / (3 * strayed_s * depth2));
  if (pose.relative_age_ns <= 0) return;
  const double age_s = rt::to_seconds(std::min(pose.relative_age_ns, options_.age_ns));
  Vec6 variances = pose.relative_covariance.diagonal();
  if (options_.pictures_err_alone) variances = (variances - 2 * pose.own_covariance.diagonal()).cwiseMax(0.0);
  told_.hear(variances.tail<3>().mean() / age_s, variances.head<3>().mean() / (depth2 * age_s));
}

void MetricMap::begin(const VisualPose& pose, const Vec3& up) {
  metric_ = true;
  told_ = false;
  corrected_by_.setZero();
  corrected_turn_.setZero();
  ++begun_;
  refusal_ = {};
  anchor_.begin(pose, up, have_nav_ ? &last_nav_ : nullptr);
}

void MetricMap::correct(const VisualPose& pose, const Vec3& up) {
  last_map_ = SE3(so3_exp(pose.turned_by) * last_map_.R, last_map_.t + pose.moved_by);
  if (!metric_) return;
  anchor_.level(up);
  corrected_by_ += pose.moved_by;
  corrected_turn_ = so3_log(anchor_.R_nav_map() * last_map_.R * last_nav_.R.transpose());
}

MetricPose MetricMap::pose_in_frame(const VisualPose& pose, double scale, const Mat3& shared, double strayed2) {
  MetricPose out;
  out.valid = true;
  out.T_nav_cam = anchor_.in_nav(pose.T_map_cam, scale);
  if (told_) {
    // The last pose as it would be told now.
    const SE3 again = anchor_.in_nav(last_map_, scale);
    out.moved_by_m = again.t - last_nav_.t;
    out.turned_by_rad = so3_log(again.R * last_nav_.R.transpose());
    out.map_moved_by_m = scale * (anchor_.R_nav_map() * corrected_by_);
    out.map_turned_by_rad = corrected_turn_;
  }
  corrected_by_.setZero();
  corrected_turn_.setZero();
  const auto J = MapAnchor::shared_errors(anchor_.way(pose.T_map_cam, scale));
  out.covariance = J * shared * J.transpose() + anchor_.grown(pose, scale, strayed2);
  out.log_scale_sigma = std::sqrt(shared(0, 0));
  told_ = have_nav_ = true;
  last_map_ = pose.T_map_cam;
  last_nav_ = out.T_nav_cam;
  return out;
}

}  // namespace godwit::vo
