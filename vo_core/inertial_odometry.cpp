#include "vo_core/inertial_odometry.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace godwit::vo {

using S = InertialState;

InertialOdometry::InertialOdometry(const CameraMounting& mounting, const InertialOdometryOptions& options)
    : options_(options), prior_(options.prior), smoother_(mounting, options.model) {}

bool InertialOdometry::camera_turn(rt::TimeNs t_ref_ns, rt::TimeNs t_cur_ns, Mat3* R_cur_ref) const {
  if (buffer_.empty() || !metric_) return false;  // before, the gyroscope's bias is not known
  const S& x = smoother_.newest();
  const rt::TimeNs shift = static_cast<rt::TimeNs>(x.time_offset_s * 1e9);
  Preintegration d(x.bias);
  const auto covered = buffer_.integrate(t_ref_ns + shift, t_cur_ns + shift, options_.model.imu, &d);
  if (covered.missing_ns > 10 * rt::kNsPerMs) return false;
  const Mat3 R_body_cam = smoother_.mounting().R_body_cam * so3_exp(x.mounting);
  *R_cur_ref = R_body_cam.transpose() * d.dR(x.bias.gyro).transpose() * R_body_cam;
  return true;
}

VisionSight InertialOdometry::sight_of(const VisualPose& pose) const {
  VisionSight sight;
  sight.R_map_cam = pose.T_map_cam.R;
  sight.camera = pose.T_map_cam.t;
  sight.depth = std::max(1e-6, pose.median_depth);
  // Of the twist (v, w) of T_cam_map along the camera's axes: the camera's place is off by -R v, its attitude by -R w.
  const Mat3& R = pose.T_map_cam.R;
  const Mat6& C = pose.own_covariance;
  sight.own.topLeftCorner<3, 3>() = R * C.bottomRightCorner<3, 3>() * R.transpose();
  sight.own.topRightCorner<3, 3>() = R * C.bottomLeftCorner<3, 3>() * R.transpose();
  sight.own.bottomLeftCorner<3, 3>() = sight.own.topRightCorner<3, 3>().transpose();
  sight.own.bottomRightCorner<3, 3>() = R * C.topLeftCorner<3, 3>() * R.transpose();
  // The rate over 10 ms around the frame.
  Preintegration around;
  buffer_.integrate(pose.t_ns - 5 * rt::kNsPerMs, pose.t_ns + 5 * rt::kNsPerMs, options_.model.imu, &around);
  if (around.dt_s() > 0) sight.gyro_rad_s = so3_log(around.dR(Vec3::Zero())) / around.dt_s();
  return sight;
}

double InertialOdometry::scene_replaced(const Vec3& camera, double depth) {
  const Vec3 ahead = camera - scene_;
  const double beyond = ahead.norm() - depth;
  if (!(beyond > 0)) return 0;
  scene_ += ahead.normalized() * beyond;
  return beyond / depth;
}

void InertialOdometry::begin_window(const VisualPose& pose) {
  if (metric_) {
    // What the sensor is like outlives the map.
    const S& x = smoother_.newest();
    prior_.bias = x.bias;
    prior_.mounting = x.mounting;
    prior_.time_offset_s = x.time_offset_s;
    const auto sigma = [&](int i, double floor) {
      return std::max(floor, 2 * std::sqrt(smoother_.covariance().diagonal().segment<3>(i).maxCoeff()));
    };
    prior_.gyro_bias_sigma = std::min(prior_.gyro_bias_sigma, sigma(S::kGyroBias, 2e-3));
    prior_.accel_bias_sigma = std::min(prior_.accel_bias_sigma, sigma(S::kAccelBias, 3e-2));
  }
  metric_ = told_ = false;
  smoother_.clear();
  map_id_ = pose.map_id;
  InertialNode node;
  node.t_ns = pose.t_ns;
  node.sight = sight_of(pose);
  scene_ = node.sight.camera;
  smoother_.add(node);
  smoother_.state(0).bias = prior_.bias;
  smoother_.state(0).mounting = prior_.mounting;
  smoother_.state(0).time_offset_s = prior_.time_offset_s;
}

bool InertialOdometry::add_node(const VisualPose& pose, rt::TimeNs after_ns) {
  const rt::TimeNs last = smoother_.node(smoother_.size() - 1).t_ns;
  if (pose.t_ns - last < after_ns) return false;
  InertialNode node;
  node.t_ns = pose.t_ns;
  node.since_last = Preintegration(smoother_.newest().bias);
  const auto covered = buffer_.integrate(last, pose.t_ns, options_.model.imu, &node.since_last);
  if (covered.missing_ns > options_.max_missing_ns || node.since_last.dt_s() <= 0) {
    refuse("inertial readings are missing [s]", rt::to_seconds(covered.missing_ns),
           rt::to_seconds(options_.max_missing_ns));
    begin_window(pose);
    return false;
  }
  node.sight = sight_of(pose);
  node.sight.new_scene = scene_replaced(node.sight.camera, node.sight.depth);
  while (metric_ && smoother_.size() >= options_.window) smoother_.drop_oldest();
  smoother_.add(node);
  return true;
}

bool InertialOdometry::refuse(const char* text, double value, double limit) {
  refusal_ = {text, value, limit};
  return false;
}

bool InertialOdometry::convincing(const InertialSmoother::Report& report) {
  if (!report.ok) return refuse("the window has no solution", 0, 0);
  const auto& C = smoother_.covariance();
  const double scale_sigma = std::sqrt(C(S::kScale, S::kScale));
  if (!(scale_sigma < options_.begin_scale_sigma))
    return refuse("the scale is not seen: its sigma", scale_sigma, options_.begin_scale_sigma);
  const double up_sigma = std::sqrt(C.diagonal().segment<2>(S::kUp).maxCoeff());
  if (!(up_sigma < options_.begin_up_sigma))
    return refuse("the vertical is not seen: its sigma [rad]", up_sigma, options_.begin_up_sigma);
  const double chi2 = report.chi2 / std::max(1, report.rows);
  if (!(chi2 < options_.begin_chi2))
    return refuse("vision and inertial sensor disagree: chi-square a degree", chi2, options_.begin_chi2);
  const ImuBias& b = smoother_.newest().bias;
  const double off = std::max((b.gyro - prior_.bias.gyro).norm() / prior_.gyro_bias_sigma,
                              (b.accel - prior_.bias.accel).norm() / prior_.accel_bias_sigma);
  if (!(off < 4)) return refuse("the biases would be absurd [sigmas]", off, 4);
  return true;
}

void InertialOdometry::try_to_begin(const VisualPose& pose) {
  const int n = smoother_.size();
  if (n < 6 || pose.t_ns - smoother_.node(0).t_ns < options_.begin_span_ns) return;
  std::array<InertialNode, InertialSmoother::kNodes> nodes;
  for (int i = 0; i < n; ++i) {
    InertialNode& node = nodes[static_cast<std::size_t>(i)];
    node = smoother_.node(i);
    node.anchor = i + 1 == n;
    node.anchor_place.setZero();
  }
  const std::span<const InertialNode> window(nodes.data(), static_cast<std::size_t>(n));
  ImuBias bias = prior_.bias;
  bias.gyro = align_gyro_bias(window, smoother_.mounting(), bias, prior_.gyro_bias_sigma, 2e-4);
  const Alignment found = align(window, smoother_.mounting(), bias, options_.model.gravity_m_s2, options_.method);
  if (!found.ok) {
    refuse("no scale fits", 0, 0);
    return;
  }
  // The moments anew, each from the one before by what the alignment found.
  smoother_.clear();
  smoother_.add(window[0]);
  S& first = smoother_.state(0);
  first.bias = found.bias;
  first.log_scale = found.log_scale;
  first.up = found.up;
  first.velocity = found.velocity;
  first.mounting = prior_.mounting;
  first.time_offset_s = prior_.time_offset_s;
  for (int i = 1; i < n; ++i) smoother_.add(window[static_cast<std::size_t>(i)]);
  smoother_.set_prior(prior_);
  if (!convincing(smoother_.solve(6))) return;
  metric_ = true;
  refusal_ = {};
  // The heading: that of the last map, or the camera's first one along x.
  R_nav_map_ = so3_exp(Vec3::Zero());
  level();
  const Vec3 ahead = R_nav_map_ * pose.T_map_cam.R.col(2);
  const Vec3 wanted = have_nav_ ? Vec3(last_nav_.R.col(2)) : Vec3(Vec3::UnitX());
  // A camera that looks straight down has no heading ahead; its picture's upper edge has.
  const bool down = std::hypot(ahead.x(), ahead.y()) < 0.1;
  const Vec3 from = down ? Vec3(-(R_nav_map_ * pose.T_map_cam.R.col(1))) : ahead;
  const Vec3 to = have_nav_ && down ? Vec3(-last_nav_.R.col(1)) : wanted;
  const double turn = std::atan2(to.y(), to.x()) - std::atan2(from.y(), from.x());
  R_nav_map_ = so3_exp(Vec3(0, 0, turn)) * R_nav_map_;
  // What is told of this frame is where the last pose was told.
  const InertialNode& node = smoother_.node(n - 1);
  const Vec3 strays = sight_residual(smoother_.newest(), node.sight, smoother_.mounting(), nullptr).tail<3>();
  anchor_nav_ = (have_nav_ ? last_nav_.t : Vec3(Vec3::Zero())) - R_nav_map_ * way_to(pose.T_map_cam.t + strays);
}

void InertialOdometry::level() {
  // The least turn that brings the map's vertical up; it leaves the heading alone.
  const Vec3 up = R_nav_map_ * smoother_.newest().up;
  const Vec3 axis = up.cross(Vec3::UnitZ());
  const double sine = axis.norm();
  if (sine < 1e-12) {
    if (up.z() < 0) R_nav_map_ = so3_exp(Vec3(M_PI, 0, 0)) * R_nav_map_;
  } else {
    R_nav_map_ = so3_exp(axis / sine * std::atan2(sine, up.z())) * R_nav_map_;
  }
  R_nav_map_ = Eigen::Quaterniond(R_nav_map_).normalized().toRotationMatrix();
}

MetricPose InertialOdometry::frame(const VisualPose& pose) {
  if (buffer_.empty()) return {};
  if (!pose.tracked) return metric_ ? coast(pose.t_ns) : MetricPose{};
  if (smoother_.size() == 0 || pose.map_id != map_id_) {
    begin_window(pose);
    return {};
  }
  if (pose.map_moved) {
    const Vec3 pivot = smoother_.newest().camera;
    smoother_.move_map(pivot, so3_exp(pose.turned_by), pose.moved_by);
    scene_ = pivot + so3_exp(pose.turned_by) * (scene_ - pivot) + pose.moved_by;
    if (metric_) {
      // The navigation frame's own view of the map stays: what was corrected, jumps.
      last_map_ = SE3(so3_exp(pose.turned_by) * last_map_.R, last_map_.t + pose.moved_by);
    }
  }
  const bool added = add_node(pose, metric_ ? options_.node_ns : options_.begin_node_ns);
  if (added && !metric_) {
    try_to_begin(pose);
  } else if (added) {
    const auto report = smoother_.solve(2);
    const double sigma = std::sqrt(smoother_.covariance()(S::kScale, S::kScale));
    if (!report.ok || !(sigma < options_.lost_scale_sigma)) {
      refuse("the scale was lost: its sigma", sigma, options_.lost_scale_sigma);
      begin_window(pose);
    } else {
      level();
    }
  }
  return metric_ ? tell(pose) : MetricPose{};
}

Vec3 InertialOdometry::way_to(const Vec3& camera_map) const {
  const S& x = smoother_.newest();
  return x.place + x.scale() * (camera_map - x.camera);
}

MetricPose InertialOdometry::tell(const VisualPose& pose) {
  const S& x = smoother_.newest();
  const InertialSmoother::Matrix& C = smoother_.covariance();
  const double s = x.scale();
  const InertialNode& node = smoother_.node(smoother_.size() - 1);
  // Most of vision's error at the newest moment is still this frame's.
  const double kept = std::exp(-rt::to_seconds(pose.t_ns - node.t_ns) / options_.model.position_time_s);
  const Vec3 strays = sight_residual(x, node.sight, smoother_.mounting(), nullptr).tail<3>();
  const Vec3 error = kept * strays, since = pose.T_map_cam.t - node.sight.camera;
  MetricPose out;
  out.valid = true;
  const Vec3 way = R_nav_map_ * way_to(pose.T_map_cam.t + error);
  out.T_nav_cam = {R_nav_map_ * pose.T_map_cam.R, anchor_nav_ + way};
  if (told_) {
    // The same frame as it would be told now.
    const Vec3 again = anchor_nav_ + R_nav_map_ * way_to(last_map_.t + error);
    out.moved_by_m = again - last_nav_.t;
    out.turned_by_rad = so3_log(R_nav_map_ * last_map_.R * last_nav_.R.transpose());
  }
  told_ = true;
  t_told_ns_ = pose.t_ns;
  last_map_ = pose.T_map_cam;

  // Velocity of the newest moment, carried on to this frame.
  const rt::TimeNs t_node = smoother_.node(smoother_.size() - 1).t_ns;
  Preintegration d(x.bias);
  buffer_.integrate(t_node, pose.t_ns, options_.model.imu, &d);
  const VisionSight here = sight_of(pose);
  const Vec3 omega = here.gyro_rad_s - x.bias.gyro;
  const Vec3 body = x.velocity - options_.model.gravity_m_s2 * d.dt_s() * x.up + x.R_map_body * d.dv(x.bias);
  const Mat3 R_map_body = x.R_map_body * d.dR(x.bias.gyro);
  out.velocity_m_s = R_nav_map_ * (body + R_map_body * omega.cross(smoother_.mounting().t_body_cam_m));

  // Errors of the way, of scale since the newest moment, and of the vertical, which tilts everything about the anchor;
  // on top what vision may have strayed since that moment, and its attitude's own error.
  const Eigen::Matrix<double, 3, 2> tilt_axes =
      R_nav_map_ * (skew(x.up) * x.up_basis());  // up x basis: the turn that moves up so; the map turns back
  Eigen::Matrix<double, 6, 6> J;                 // by (scale, up, place)
  J.setZero();
  J.block<3, 1>(0, 0) = s * (R_nav_map_ * since);
  J.block<3, 2>(0, 1) = skew(way) * tilt_axes;
  J.block<3, 3>(0, 3) = R_nav_map_;
  J.block<3, 2>(3, 1) = -tilt_axes;
  Mat6 P;
  P.topLeftCorner<3, 3>() = C.block<3, 3>(S::kScale, S::kScale);
  P.topRightCorner<3, 3>() = C.block<3, 3>(S::kScale, S::kPlace);
  P.bottomLeftCorner<3, 3>() = C.block<3, 3>(S::kPlace, S::kScale);
  P.bottomRightCorner<3, 3>() = C.block<3, 3>(S::kPlace, S::kPlace);
  out.covariance = J * P * J.transpose();
  const double strayed = options_.model.position_sigma * s * here.depth;
  out.covariance.diagonal().head<3>().array() += strayed * strayed * (1 - kept * kept);
  out.covariance.topLeftCorner<3, 3>() +=
      s * s * (R_nav_map_ * here.own.bottomRightCorner<3, 3>() * R_nav_map_.transpose());
  out.covariance.bottomRightCorner<3, 3>() += R_nav_map_ * here.own.topLeftCorner<3, 3>() * R_nav_map_.transpose();
  out.covariance.diagonal().tail<3>().array() += options_.model.rotation_sigma * options_.model.rotation_sigma;
  out.velocity_covariance = R_nav_map_ * C.block<3, 3>(S::kVelocity, S::kVelocity) * R_nav_map_.transpose();
  out.log_scale_sigma = std::sqrt(C(S::kScale, S::kScale));
  last_nav_ = out.T_nav_cam;
  last_variance_m2_ = out.covariance.topLeftCorner<3, 3>().trace();
  have_nav_ = true;
  return out;
}

MetricPose InertialOdometry::coast(rt::TimeNs t_ns) {
  const S& x = smoother_.newest();
  const InertialNode& node = smoother_.node(smoother_.size() - 1);
  if (t_ns - t_told_ns_ > options_.coast_ns) return {};
  const rt::TimeNs shift = static_cast<rt::TimeNs>(x.time_offset_s * 1e9);
  Preintegration d(x.bias);
  const auto covered = buffer_.integrate(node.t_ns + shift, t_ns + shift, options_.model.imu, &d);
  if (covered.missing_ns > 30 * rt::kNsPerMs || !(d.dt_s() > 0)) return {};
  const double dt = d.dt_s(), gravity = options_.model.gravity_m_s2;
  const Vec3 arm = smoother_.mounting().t_body_cam_m, g = -gravity * x.up;
  const Mat3 dR = d.dR(x.bias.gyro), R = x.R_map_body * dR;
  const Vec3 dv = d.dv(x.bias), dp = d.dp(x.bias);
  const Mat3 R_body_cam = smoother_.mounting().R_body_cam * so3_exp(x.mounting);
  MetricPose out;
  out.valid = out.coasted = true;
  const Vec3 place = x.place + x.velocity * dt + 0.5 * dt * dt * g + x.R_map_body * dp + (R - x.R_map_body) * arm;
  const Vec3 way = R_nav_map_ * place;
  // The attitude goes on from vision's own.
  out.T_nav_cam = {R_nav_map_ * node.sight.R_map_cam * R_body_cam.transpose() * dR * R_body_cam, anchor_nav_ + way};
  const Vec3 velocity = x.velocity + g * dt + x.R_map_body * dv;
  out.velocity_m_s = R_nav_map_ * velocity;

  // Errors of (place, attitude), along the navigation frame's axes, and of the velocity, by those of the moment.
  const Eigen::Matrix<double, 3, 2> B = x.up_basis();
  const Eigen::Matrix<double, 3, 2> tilt_axes = R_nav_map_ * (skew(x.up) * B);
  Eigen::Matrix<double, 9, S::kSize> J;
  J.setZero();
  const Mat3 N = R_nav_map_ * x.R_map_body, M = R_nav_map_ * R;
  J.block<3, 3>(0, S::kRotation) = -N * skew(dp) - M * skew(arm) * dR.transpose() + N * skew(arm);
  J.block<3, 3>(0, S::kVelocity) = dt * R_nav_map_;
  J.block<3, 3>(0, S::kGyroBias) = N * d.dp_dbg() - M * skew(arm) * d.dR_dbg();
  J.block<3, 3>(0, S::kAccelBias) = N * d.dp_dba();
  J.block<3, 2>(0, S::kUp) = skew(way) * tilt_axes - 0.5 * dt * dt * gravity * R_nav_map_ * B;
  J.block<3, 3>(0, S::kPlace) = R_nav_map_;
  J.block<3, 3>(3, S::kRotation) = N;
  J.block<3, 3>(3, S::kGyroBias) = M * d.dR_dbg();
  J.block<3, 2>(3, S::kUp) = -tilt_axes;
  J.block<3, 3>(6, S::kRotation) = -N * skew(dv);
  J.block<3, 3>(6, S::kVelocity) = R_nav_map_;
  J.block<3, 3>(6, S::kGyroBias) = N * d.dv_dbg();
  J.block<3, 3>(6, S::kAccelBias) = N * d.dv_dba();
  J.block<3, 2>(6, S::kUp) = skew(out.velocity_m_s) * tilt_axes - dt * gravity * R_nav_map_ * B;
  const Eigen::Matrix<double, 9, S::kSize> JC = J.lazyProduct(smoother_.covariance());
  Mat9 P = JC.lazyProduct(J.transpose());
  // What the readings add; preintegration's order is (turn, speed, way).
  Mat9 to_nav = Mat9::Zero();
  to_nav.block<3, 3>(0, 6) = to_nav.block<3, 3>(6, 3) = N;
  to_nav.block<3, 3>(3, 0) = M;
  P += to_nav.lazyProduct(d.covariance()).eval().lazyProduct(to_nav.transpose());
  out.covariance = P.topLeftCorner<6, 6>();
  out.covariance.diagonal().tail<3>().array() += options_.model.rotation_sigma * options_.model.rotation_sigma;
  out.velocity_covariance = P.bottomRightCorner<3, 3>();
  out.log_scale_sigma = std::sqrt(smoother_.covariance()(S::kScale, S::kScale));
  const double grown = out.covariance.topLeftCorner<3, 3>().trace() - last_variance_m2_;
  if (grown > options_.coast_sigma_m * options_.coast_sigma_m) return {};
  last_nav_ = out.T_nav_cam;
  told_ = false;  // what comes next is no correction of this
  return out;
}

}  // namespace godwit::vo
