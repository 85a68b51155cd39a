#include "firmware_app/pipeline/inertial_poses.h"

#include <Eigen/Geometry>

namespace godwit::app {
namespace {

/// What the gyroscope's turn over a frame is taken to be wrong by. Measured against vision's on euroc_mh01: 0.3 to 0.5
/// mrad RMS, but 3 mrad for a while where mounting and time offset had not settled; with 1 and with 3 mrad the start at
/// frame 135 lost its pose there, with 5 none did.
constexpr double kTurnSigmaRad = 5e-3;

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

}  // namespace

InertialPoses::InertialPoses(const std::array<double, 16>& T_body_cam)
    : odometry_(std::make_unique<vo::InertialOdometry>(mounting_of(T_body_cam))) {}

void InertialPoses::take(const hal::ImuSample& s) {
  odometry_->add({s.t_ns, Eigen::Vector3d(s.gyro_rad_s.data()), Eigen::Vector3d(s.accel_m_s2.data())});
}

vo::RotationPrior InertialPoses::turn_since_last(rt::TimeNs t_ns) const {
  vo::RotationPrior prior;
  if (t_last_ns_ > 0 && odometry_->camera_turn(t_last_ns_, t_ns, &prior.R_cur_ref)) prior.sigma_rad = kTurnSigmaRad;
  return prior;
}

void InertialPoses::make_metric(const vo::FrameResult& result, rt::TimeNs t_ns, FrameRecord* record) {
  t_last_ns_ = t_ns;
  vo::VisualPose seen;
  seen.t_ns = t_ns;
  seen.tracked = result.tracked;
  seen.map_id = result.map_id;
  seen.T_map_cam = result.T_world_cam;
  seen.covariance = result.covariance;
  seen.median_depth = result.median_depth;
  seen.map_moved = result.map_moved;
  seen.moved_by = result.moved_by;
  seen.turned_by = result.turned_by;
  const vo::MetricPose pose = odometry_->frame(seen);
  if (!pose.valid) {
    if (record->has_pose) {
      record->tracked = record->has_pose = false;
      record->state = vo::State::kInitialising;
      const auto& why = odometry_->refusal();
      const char* const text = why.text[0] != '\0' ? why.text : "waiting for motion that shows scale and vertical";
      // In thousandths: a reason's figures are whole numbers.
      record->why = {text, measured_figure(1000 * why.value), measured_figure(1000 * why.limit)};
      record->reason.assign_measured(text, record->why.value, record->why.limit);
    }
    return;
  }
  record->metric = true;
  const Eigen::Quaterniond q = pose.T_nav_cam.quaternion();
  record->q_world_cam = {q.x(), q.y(), q.z(), q.w()};
  Eigen::Map<Eigen::Vector3d>(record->t_world_cam.data()) = pose.T_nav_cam.t;
  Eigen::Map<Eigen::Vector3d>(record->velocity.data()) = pose.velocity_m_s;
  Eigen::Map<Eigen::Vector3d>(record->moved_by.data()) = pose.moved_by_m;
  Eigen::Map<Eigen::Vector3d>(record->turned_by.data()) = pose.turned_by_rad;
  record->map_moved = result.map_moved || pose.moved_by_m.squaredNorm() > 0;
  const vo::InertialState& x = odometry_->smoother().newest();
  record->inertial.log_scale_sigma = pose.log_scale_sigma;
  Eigen::Map<Eigen::Vector3d>(record->inertial.gyro_bias.data()) = x.bias.gyro;
  Eigen::Map<Eigen::Vector3d>(record->inertial.accel_bias.data()) = x.bias.accel;
  Eigen::Map<Eigen::Vector3d>(record->inertial.mounting.data()) = x.mounting;
  record->inertial.time_offset_s = x.time_offset_s;
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

}  // namespace godwit::app
