#include "firmware_app/pipeline/aided_poses.h"

#include "firmware_app/pipeline/metric_record.h"

namespace godwit::app {
namespace {

vo::NavigationPose navigation_pose(const vo::MetricPose& pose, std::uint32_t frame_id) {
  vo::NavigationPose out;
  out.source = vo::NavigationPose::Source::kSeen;
  out.T_nav_cam = pose.T_nav_cam;
  out.velocity_m_s = pose.velocity_m_s;
  out.covariance = pose.covariance;
  out.velocity_covariance = pose.velocity_covariance;
  out.frame_id = frame_id;
  out.moved_by_m = pose.moved_by_m;
  out.turned_by_rad = pose.turned_by_rad;
  return out;
}

}  // namespace

AidedPoses::AidedPoses(const std::array<double, 16>& T_body_cam)
    : odometry_(std::make_unique<vo::AidedOdometry>(mounting_of(T_body_cam))) {}

void AidedPoses::take(const hal::AidSample& s) {
  if (s.kind == hal::AidKind::kAttitude) {
    odometry_->take(vo::AttitudeReading{s.t_ns, Eigen::Vector3d(s.value.data()), s.sigma});
  } else {
    odometry_->take(reading_of(s));
  }
}

void AidedPoses::starts_at_height(double height_m) {
  odometry_->take(start_reading(height_m));
}

void AidedPoses::make_metric(const vo::FrameResult& result, rt::TimeNs t_ns, FrameRecord* record) {
  // Nothing was measured, and what was told stands.
  if (result.repeated) return;
  const vo::MetricPose metric = odometry_->frame(visual_pose(result, t_ns, t_ns));
  if (metric.valid) {
    fill_metric(navigation_pose(metric, odometry_->begun()), record);
    record->inertial.log_scale_sigma = metric.log_scale_sigma;
    tell_shares(odometry_->scale(), &record->inertial);
    // What is enough to be told is less than what is enough beside an inertial sensor.
    record->inertial.aided_log_sigma = metric.log_scale_sigma;
  } else if (record->has_pose && odometry_->attitude_heard()) {
    const auto& why = odometry_->refusal();
    tell_unmetric(why.text, why.value, why.limit, record);
  }
}

}  // namespace godwit::app
