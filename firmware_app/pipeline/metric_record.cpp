#include "firmware_app/pipeline/metric_record.h"

#include <Eigen/Geometry>
#include <cmath>

namespace godwit::app {
namespace {

/// All of vision's numbers that are used are numbers.
bool finite(const vo::FrameResult& r) {
  return r.T_world_cam.R.allFinite() && r.T_world_cam.t.allFinite() && r.covariance.allFinite() &&
         r.own_covariance.allFinite() && r.relative.covariance.allFinite() && std::isfinite(r.median_depth) &&
         r.moved_by.allFinite() && r.turned_by.allFinite();
}

}  // namespace

vo::CameraMounting mounting_of(const std::array<double, 16>& T) {
  vo::CameraMounting out;
  for (std::size_t row = 0; row < 3; ++row) {
    for (std::size_t column = 0; column < 3; ++column) {
      out.R_body_cam(static_cast<int>(row), static_cast<int>(column)) = T[4 * row + column];
    }
    out.t_body_cam_m[static_cast<int>(row)] = T[4 * row + 3];
  }
  // A file's digits are no rotation to the last bit.
  out.R_body_cam = Eigen::Quaterniond(out.R_body_cam).normalized().toRotationMatrix();
  return out;
}

vo::VisualPose visual_pose(const vo::FrameResult& result, rt::TimeNs t_capture_ns, rt::TimeNs t_ns) {
  vo::VisualPose seen;
  seen.t_ns = t_ns;
  seen.tracked = result.tracked && finite(result);
  if (!seen.tracked && result.init.status == vo::InitStatus::kNoMotion) seen.still_rad = result.init.still_rad;
  seen.map_id = result.map_id;
  seen.T_map_cam = result.T_world_cam;
  seen.covariance = result.covariance;
  seen.own_covariance = result.own_covariance;
  seen.relative_covariance = result.relative.covariance;
  if (result.relative.keyframe_id != 0) seen.relative_age_ns = t_capture_ns - result.relative.t_keyframe_ns;
  seen.median_depth = result.median_depth;
  seen.points = std::span(result.points.at).first(result.points.count);
  seen.map_moved = result.map_moved;
  seen.moved_by = result.moved_by;
  seen.turned_by = result.turned_by;
  return seen;
}

void fill_metric(const vo::NavigationPose& pose, FrameRecord* record) {
  record->metric = true;
  record->frame_id = pose.frame_id;
  record->trust = pose.trust;
  const Eigen::Quaterniond q = pose.T_nav_cam.quaternion();
  record->q_world_cam = {q.x(), q.y(), q.z(), q.w()};
  Eigen::Map<Eigen::Vector3d>(record->t_world_cam.data()) = pose.T_nav_cam.t;
  Eigen::Map<Eigen::Vector3d>(record->velocity.data()) = pose.velocity_m_s;
  Eigen::Map<Eigen::Vector3d>(record->moved_by.data()) = pose.moved_by_m;
  Eigen::Map<Eigen::Vector3d>(record->turned_by.data()) = pose.turned_by_rad;
  record->map_moved = pose.moved_by_m.squaredNorm() + pose.turned_by_rad.squaredNorm() > 0;
  // The record's covariance is along the camera's axes (see autopilot/pose_sampler.cpp).
  vo::Mat6 to_cam = vo::Mat6::Zero();
  to_cam.topLeftCorner<3, 3>() = to_cam.bottomRightCorner<3, 3>() = pose.T_nav_cam.R.transpose();
  const vo::Mat6 C = to_cam * pose.covariance * to_cam.transpose();
  std::size_t k = 0, v = 0;
  for (int row = 0; row < 6; ++row) {
    for (int column = row; column < 6; ++column) record->covariance[k++] = C(row, column);
    for (int column = row; column < 3; ++column)
      record->velocity_covariance[v++] = pose.velocity_covariance(row, column);
  }
}

vo::AidReading reading_of(const hal::AidSample& s, rt::TimeNs shift_ns) {
  constexpr std::array<vo::ScaleSource, hal::kLengthKinds> kSources = {
      vo::ScaleSource::kRange, vo::ScaleSource::kBarometer, vo::ScaleSource::kSatellites};
  return {kSources[static_cast<std::size_t>(s.kind)], s.t_ns + shift_ns, Eigen::Vector3d(s.value.data()), s.sigma};
}

vo::AidReading start_reading(double height_m) {
  // What it is wrong by is the source's (vo::ScaleOptions::bias_sigma).
  return {vo::ScaleSource::kStartHeight, 0, Eigen::Vector3d(0, 0, height_m), 0};
}

void tell_shares(const vo::ScaleState& scale, InertialRecord* record) {
  record->aided_log_sigma = scale.known() ? scale.log_sigma() : 0;
  for (std::size_t i = 0; i < vo::kScaleSources; ++i)
    record->aid_share[i] = scale.share(static_cast<vo::ScaleSource>(i));
}

void tell_unmetric(const char* why, double value, double limit, FrameRecord* record) {
  record->tracked = record->has_pose = false;
  record->state = vo::State::kInitialising;
  record->why = {why, measured_figure(value), measured_figure(limit)};
  record->reason.assign_measured(why, record->why.value, record->why.limit);
}

}  // namespace godwit::app
