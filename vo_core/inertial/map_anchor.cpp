#include "vo_core/inertial/map_anchor.h"

#include <Eigen/Eigenvalues>
#include <cmath>

#include "vo_core/map/pose_certainty.h"

namespace godwit::vo {

void MapAnchor::begin(const MapPose& pose, const Vec3& up, const SE3* last_nav) {
  anchor_map_ = pose.T_map_cam;
  anchor_covariance_ = pose.covariance;
  R_nav_map_ = Mat3::Identity();
  level(up);
  const Mat3 now = R_nav_map_ * pose.T_map_cam.R;
  const Mat3 last = last_nav != nullptr ? last_nav->R : now;
  // A camera that looks straight down has no heading ahead; its picture's upper edge has.
  const bool down = std::hypot(now(0, 2), now(1, 2)) < 0.1 || std::hypot(last(0, 2), last(1, 2)) < 0.1;
  const auto ahead = [down](const Mat3& R) { return down ? Vec3(-R.col(1)) : Vec3(R.col(2)); };
  const Vec3 from = ahead(now), to = last_nav != nullptr ? ahead(last) : Vec3(Vec3::UnitX());
  const double turn = std::atan2(to.y(), to.x()) - std::atan2(from.y(), from.x());
  R_nav_map_ = so3_exp(Vec3(0, 0, turn)) * R_nav_map_;
  anchor_nav_ = last_nav != nullptr ? last_nav->t : Vec3(Vec3::Zero());
}

void MapAnchor::level(const Vec3& up_in_map) {
  const Vec3 up = R_nav_map_ * up_in_map, axis = up.cross(Vec3::UnitZ());
  const double sine = axis.norm();
  if (sine >= 1e-12) {
    R_nav_map_ = so3_exp(axis / sine * std::atan2(sine, up.z())) * R_nav_map_;
  } else if (up.z() < 0) {
    R_nav_map_ = so3_exp(Vec3(M_PI, 0, 0)) * R_nav_map_;
  }
  R_nav_map_ = Eigen::Quaterniond(R_nav_map_).normalized().toRotationMatrix();
}

SE3 MapAnchor::in_nav(const SE3& T_map_cam, double scale) const {
  return {R_nav_map_ * T_map_cam.R, anchor_nav_ + way(T_map_cam, scale)};
}

SE3 MapAnchor::in_map(const SE3& T_nav_cam, double scale) const {
  const Mat3 R_map_nav = R_nav_map_.transpose();
  return {R_map_nav * T_nav_cam.R, anchor_map_.t + R_map_nav * (T_nav_cam.t - anchor_nav_) / scale};
}

Eigen::Matrix<double, 6, 3> MapAnchor::shared_errors(const Vec3& way) {
  Eigen::Matrix<double, 6, 3> J = Eigen::Matrix<double, 6, 3>::Zero();
  J.block<3, 1>(0, 0) = way;
  J.block<3, 2>(0, 1) = -skew(way).leftCols<2>();
  J.block<2, 2>(3, 1).setIdentity();
  return J;
}

Mat6 MapAnchor::grown(const MapPose& pose, double scale, double strayed2) const {
  const Mat6 to_here = adjoint(pose.T_map_cam.inverse() * anchor_map_);
  const Mat6 difference = pose.covariance - to_here * anchor_covariance_ * to_here.transpose();
  // The map may know both better by now than it said of the anchor then: no less than nothing.
  const Eigen::SelfAdjointEigenSolver<Mat6> eigen(0.5 * (difference + difference.transpose()));
  const Mat6& axes = eigen.eigenvectors();
  Mat6 own = axes * eigen.eigenvalues().cwiseMax(0.0).asDiagonal() * axes.transpose();
  if (strayed2 > 0) {
    const Eigen::SelfAdjointEigenSolver<Mat3> places(own.topLeftCorner<3, 3>());
    const Vec3 missing = (Vec3::Constant(strayed2) - places.eigenvalues()).cwiseMax(0.0);
    own.topLeftCorner<3, 3>() += places.eigenvectors() * missing.asDiagonal() * places.eigenvectors().transpose();
  }
  own += pose.own_covariance;
  const Mat3 R_nav_cam = R_nav_map_ * pose.T_map_cam.R;
  Mat6 to_nav = Mat6::Zero();
  to_nav.topLeftCorner<3, 3>() = scale * R_nav_cam;
  to_nav.bottomRightCorner<3, 3>() = R_nav_cam;
  return to_nav * own * to_nav.transpose();
}

}  // namespace godwit::vo
