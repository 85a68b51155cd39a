#include "vo_core/inertial/aided_odometry.h"

#include <algorithm>
#include <cmath>

namespace godwit::vo {
namespace {

/// An axis, where nothing is known of it but that it flies [m/s].
constexpr double kUnknownSpeed = 10;

double square(double x) {
  return x * x;
}

}  // namespace

void AidedOdometry::correct_map(const VisualPose& pose) {
  if (!pose.map_moved || pose.map_id != map_id_) return;
  const MapCorrection correction = correction_of(pose, t_last_ns_, last_camera_);
  aids_.correct_map(correction);
  vertical_.correct_map(correction);
  fit_.shift(pose.moved_by);
  last_camera_ += pose.moved_by;
  correct(pose, vertical_.up());
}

void AidedOdometry::hear(const VisualPose& pose) {
  stray_.judge(pose);
  vertical_.pose(pose.t_ns, pose.map_id, pose.T_map_cam.R, stray_.rotation_rate());
  AidPose p;
  p.t_ns = pose.t_ns;
  p.map_id = pose.map_id;
  p.camera = pose.T_map_cam.t;
  p.depth = pose.median_depth;
  p.points = pose.points;
  p.beam = pose.T_map_cam.R * (R_cam_body_ * options_.range_beam);
  if (vertical_.known()) {
    p.up = vertical_.up();
    p.up_sigma = vertical_.sigma_rad();
  }
  aids_.pose(p);
}

bool AidedOdometry::good_enough() {
  const double most_up = metric() ? options_.lost_up_sigma : options_.begin_up_sigma;
  const double most_scale = metric() ? options_.lost_scale_sigma : options_.begin_scale_sigma;
  if (vertical_.distrusted()) return refuse("the autopilot's attitude contradicts the pictures", 0, 0);
  if (!vertical_.known()) return refuse("waiting for the autopilot's attitude", 0, 0);
  if (!(vertical_.sigma_rad() < most_up))
    return refuse("the autopilot's attitude does not show the vertical: its sigma [mrad]", 1e3 * vertical_.sigma_rad(),
                  1e3 * most_up);
  if (!(aids_.state().log_sigma() < most_scale))
    return refuse("nobody tells the scale well enough: its sigma [0.1 %]", 1e3 * aids_.state().log_sigma(),
                  1e3 * most_scale);
  return true;
}

MetricPose AidedOdometry::frame(const VisualPose& pose) {
  if (!pose.tracked) return {};
  correct_map(pose);
  hear(pose);
  const bool another = pose.map_id != map_id_;
  map_id_ = pose.map_id;
  if (another) {
    end();
    fit_.clear();
  }
  fit_.add(pose.t_ns, pose.T_map_cam.t);
  if (!good_enough()) {
    end();
  } else {
    if (!metric()) {
      begin(pose, vertical_.up());
      way_ = 0;
      last_camera_ = pose.T_map_cam.t;
    }
    anchor_.level(vertical_.up());
  }
  way_ += (pose.T_map_cam.t - last_camera_).norm();
  last_camera_ = pose.T_map_cam.t;
  t_last_ns_ = pose.t_ns;
  return metric() ? tell(pose) : MetricPose{};
}

MetricPose AidedOdometry::tell(const VisualPose& pose) {
  const double s = aids_.state().scale();
  const Mat3 shared =
      Vec3(square(aids_.state().log_sigma()), square(vertical_.sigma_rad()), square(vertical_.sigma_rad()))
          .asDiagonal();
  MetricPose out = pose_in_frame(pose, s, shared);
  const double place = std::hypot(options_.position_sigma * s * pose.median_depth, options_.told_place_sigma_m);
  out.covariance.diagonal().head<3>().array() += square(place) + square(options_.drift_share * s * way_);
  out.covariance.diagonal().tail<3>().array() += square(options_.rotation_sigma);
  tell_velocity(pose, shared, &out);
  return out;
}

void AidedOdometry::tell_velocity(const VisualPose& pose, const Mat3& shared, MetricPose* out) {
  if (fit_.points() < 2) {
    out->velocity_covariance = square(kUnknownSpeed) * Mat3::Identity();
    return;
  }
  const double s = aids_.state().scale();
  const auto motion = fit_.at(pose.t_ns, std::sqrt(std::max(0.0, pose.own_covariance.diagonal().head<3>().mean())));
  out->velocity_m_s = s * (anchor_.R_nav_map() * motion.velocity);
  const Eigen::Matrix3d J = MapAnchor::shared_errors(out->velocity_m_s).topRows<3>();
  out->velocity_covariance = J * shared * J.transpose();
  out->velocity_covariance.diagonal().array() +=
      s * s * motion.velocity_variance + square(options_.told_speed_sigma_m_s);
}

}  // namespace godwit::vo
