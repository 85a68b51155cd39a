#include "firmware_app/autopilot/pose_sampler.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace godwit::app {
namespace {

constexpr double kJumpPosition = 0.05;           // [m]
constexpr double kJumpAngle = 1.0 * M_PI / 180;  // [rad]
constexpr double kLeastTrust = 0.1;

/// Rotation vector from one attitude to the other, in the axes of `from`.
Eigen::Vector3d turn(const Eigen::Quaterniond& from, const Eigen::Quaterniond& to) {
  const Eigen::AngleAxisd a((from.conjugate() * to).normalized());
  return a.angle() * a.axis();
}

/// The record holds the covariance of the left twist (v, w) of T_cam_world: T_true = exp(x) T. The position of the
/// camera in the world is then off by -R_world_cam v, its attitude by -R_world_cam w along world axes.
Eigen::Matrix<double, 6, 6> world_covariance(const std::array<double, 21>& covariance,
                                             const Eigen::Matrix3d& R_world_cam) {
  Eigen::Matrix<double, 6, 6> C;
  std::size_t k = 0;
  for (int row = 0; row < 6; ++row) {
    for (int column = row; column < 6; ++column) C(row, column) = C(column, row) = covariance[k++];
  }
  Eigen::Matrix<double, 6, 6> R = Eigen::Matrix<double, 6, 6>::Zero();
  R.topLeftCorner<3, 3>() = R.bottomRightCorner<3, 3>() = R_world_cam;
  return R * C * R.transpose();
}

double sigma_of(const Eigen::Matrix<double, 6, 6>& C, int first) {
  return std::sqrt(std::max(0.0, C.diagonal().segment<3>(first).mean()));
}

}  // namespace

Eigen::Matrix3d world_of_level_start(const Eigen::Matrix3d& R_body_cam) {
  // Level and heading along the world's x: front is x, right is -y, down is -z.
  return Eigen::Vector3d(1, -1, -1).asDiagonal() * R_body_cam;
}

Eigen::Matrix3d PoseSampler::world_of(const FrameRecord& record) const {
  return record.metric ? Eigen::Matrix3d(Eigen::Matrix3d::Identity()) : R_world_map_;
}

void PoseSampler::follow_correction(const FrameRecord& record, const Eigen::Matrix<double, 6, 6>& covariance) {
  if (!record.map_moved) return;
  const Eigen::Vector3d moved = world_of(record) * Eigen::Vector3d(record.moved_by.data());
  const Eigen::Vector3d turned = world_of(record) * Eigen::Vector3d(record.turned_by.data());
  fit_.shift(moved);
  last_q_ = Eigen::AngleAxisd(turned.norm(), turned.stableNormalized()) * last_q_;
  if (moved.norm() > std::max(3 * sigma_of(covariance, 0), kJumpPosition) ||
      turned.norm() > std::max(3 * sigma_of(covariance, 3), kJumpAngle)) {
    ++jumps_;
  }
}

void PoseSampler::tell_north(const FrameRecord& record, link::PoseSample* s) {
  const EarthRecord& earth = record.earth;
  const bool known = earth.known && std::isfinite(earth.heading) && std::isfinite(earth.heading_sigma);
  if (!north_ || !record.metric || !(known || north_told_)) return;
  // Of the x axis, "from east towards north" to "clockwise from north". Who forgets it does not turn the frame back.
  const double heading = known ? M_PI / 2 - earth.heading : heading_;
  const double sigma = known ? earth.heading_sigma : M_PI;
  if (!north_told_ || std::abs(std::remainder(heading - heading_, 2 * M_PI)) > std::max(sigma, kJumpAngle)) {
    const Eigen::Vector2d here(record.t_world_cam[0], record.t_world_cam[1]);
    const Eigen::Vector2d told =
        Eigen::Rotation2Dd(north_told_ ? -heading_ : 0) * here + Eigen::Vector2d(moved_by_.data());
    Eigen::Map<Eigen::Vector2d>(moved_by_.data()) = told - Eigen::Rotation2Dd(-heading) * here;
    turned_about_ = {here.x(), here.y()};
    heading_ = heading;
    north_told_ = true;
    ++jumps_;
  }
  s->heading_known = true;
  s->heading_rad = heading_;
  s->heading_variance = sigma * sigma + std::pow(std::remainder(heading - heading_, 2 * M_PI), 2);
  s->north_about = turned_about_;
  s->north_moved = moved_by_;
  s->reset_counter = jumps_;
}

link::PoseSample PoseSampler::sample(const FrameRecord& record) {
  link::PoseSample s;
  s.t_capture_ns = record.t_capture_ns;
  s.state = record.state;
  s.map_id = record.metric ? record.frame_id : record.map_id;
  s.measurements = static_cast<std::uint16_t>(std::clamp(record.features, 0, 65535));
  s.reset_counter = jumps_;
  if (!record.has_pose) {
    // A state that claims a pose where there is none must not pass for one.
    if (vo::claims_pose(s.state)) s.state = link::PoseState::kRelocalising;
    fit_.clear();
    has_last_ = false;
    return s;
  }
  if (s.map_id != map_id_) {
    map_id_ = s.map_id;
    fit_.clear();
    has_last_ = false;
  }
  const Eigen::Quaterniond q_map_cam(record.q_world_cam[3], record.q_world_cam[0], record.q_world_cam[1],
                                     record.q_world_cam[2]);
  const Eigen::Quaterniond q_world_cam = (Eigen::Quaterniond(world_of(record)) * q_map_cam).normalized();
  const Eigen::Vector3d position = world_of(record) * Eigen::Vector3d(record.t_world_cam.data());
  const Eigen::Matrix3d R_world_cam = q_world_cam.toRotationMatrix();
  const Eigen::Matrix<double, 6, 6> covariance = world_covariance(record.covariance, R_world_cam);
  follow_correction(record, covariance);
  s.reset_counter = jumps_;

  fit_.add(record.t_capture_ns, position);
  s.has_velocity = fit_.points() >= 2;
  Eigen::Map<Eigen::Vector3d>(s.position.data()) = position;
  s.orientation = {q_world_cam.w(), q_world_cam.x(), q_world_cam.y(), q_world_cam.z()};
  Eigen::Map<Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(s.covariance.data()) = covariance;
  if (record.metric) {
    s.has_scale = s.has_gravity = s.has_velocity = true;
    tell_north(record, &s);
    s.trust = record.trust;
    s.velocity = record.velocity;
    const auto& c = record.velocity_covariance;
    s.velocity_covariance = {c[0], c[1], c[2], c[1], c[3], c[4], c[2], c[4], c[5]};
    // What vision and inertial sensor disagree by is in neither's covariance.
    const double inflation = 1 / std::pow(std::clamp(record.trust, kLeastTrust, 1.0), 2);
    for (double& variance : s.covariance) variance *= inflation;
    for (double& variance : s.velocity_covariance) variance *= inflation;
    s.motion = record.motion;
    for (double& variance : s.motion.covariance) variance *= inflation;
    s.heading_variance *= inflation;
  } else if (s.has_velocity) {
    // Positions on end share what the map is off by: between them only each frame's own noise counts.
    const double own_sigma = sigma_of(world_covariance(record.own_covariance, R_world_cam), 0);
    const vo::VelocityFit::Estimate motion = fit_.at(record.t_capture_ns, own_sigma);
    Eigen::Map<Eigen::Vector3d>(s.velocity.data()) = motion.velocity;
    for (std::size_t i = 0; i < 3; ++i) s.velocity_covariance[4 * i] = motion.velocity_variance;
  }
  const rt::TimeNs dt_ns = record.t_capture_ns - t_last_ns_;
  if (has_last_ && dt_ns > 0) {
    Eigen::Map<Eigen::Vector3d>(s.angular_velocity.data()) = turn(last_q_, q_world_cam) / rt::to_seconds(dt_ns);
  }
  has_last_ = true;
  t_last_ns_ = record.t_capture_ns;
  last_q_ = q_world_cam;
  return s;
}

}  // namespace godwit::app
