#include "firmware_app/link/odometry_message.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace godwit::link {
namespace {

constexpr double kMaxPosition = 1e5;
constexpr double kMaxVelocity = 300;
constexpr double kMaxRate = 100;
constexpr double kMinVariance = 1e-8;
/// One sigma, an axis, that alone halves the quality.
constexpr double kHalfPosition = 3;            // [m]
constexpr double kHalfAngle = 5 * M_PI / 180;  // [rad]
constexpr double kHalfVelocity = 0.5;          // [m/s]

Eigen::Matrix3d skew(const Eigen::Vector3d& v) {
  return Eigen::Matrix3d{{0, -v.z(), v.y()}, {v.z(), 0, -v.x()}, {-v.y(), v.x(), 0}};
}

template <typename Array>
bool finite(const Array& values) {
  return std::all_of(values.begin(), values.end(), [](double v) { return std::isfinite(v); });
}

bool points_north(const PoseSample& s, const OdometryConfig& config) {
  return config.north && s.heading_known && s.has_gravity && std::isfinite(s.heading_rad) &&
         std::isfinite(s.heading_variance) && s.heading_variance >= 0;
}

using Covariance = Eigen::Matrix<double, 6, 6, Eigen::RowMajor>;

/// Along the world's axes, as it is in the frame that is sent. Where that points north the heading is off by what north
/// is off by, and by no more: what the camera's own heading strayed by, as far as north does not know of it, is in
/// there. It turns all of it about where the frame was turned.
Covariance sent_covariance(const PoseSample& s, const OdometryConfig& config) {
  constexpr int kHeading = 5;
  Covariance C = Eigen::Map<const Covariance>(s.covariance.data());
  if (!points_north(s, config)) return C;
  C.row(kHeading).setZero();
  C.col(kHeading).setZero();
  Eigen::Matrix<double, 6, 1> turned;
  turned << s.north_about[1] - s.position[1], s.position[0] - s.north_about[0], 0, Eigen::Vector3d::UnitZ();
  return C + s.heading_variance * turned * turned.transpose();
}

// World (z up) to the profile's local frame (z down).
Eigen::Matrix3d local_from_world(const PoseSample& s, const OdometryConfig& config) {
  Eigen::Matrix3d frd = Eigen::Vector3d(1, -1, -1).asDiagonal();
  if (points_north(s, config))
    return Eigen::AngleAxisd(s.heading_rad, Eigen::Vector3d::UnitZ()).toRotationMatrix() * frd;
  if (config.profile == Profile::kArdupilot) return frd;
  return Eigen::AngleAxisd(config.world_heading_rad, Eigen::Vector3d::UnitZ()).toRotationMatrix() * frd;
}

// Makes a covariance one that an estimator can take: symmetric, variances within [kMinVariance, most]; a row whose
// variance had to be cut loses its correlations, which belonged to the larger one.
template <int N>
void tame_covariance(Eigen::Matrix<double, N, N>* c, const Eigen::Matrix<double, N, 1>& most) {
  *c = (0.5 * (*c + c->transpose())).eval();
  for (int i = 0; i < N; ++i) {
    const double variance = (*c)(i, i);
    if (variance >= kMinVariance && variance <= most(i)) continue;
    c->row(i).setZero();
    c->col(i).setZero();
    (*c)(i, i) = variance < kMinVariance ? kMinVariance : most(i);
  }
}

bool usable(const PoseSample& s) {
  if (!vo::claims_pose(s.state) || !finite(s.position) || !finite(s.orientation) || !finite(s.velocity) ||
      !finite(s.angular_velocity) || !finite(s.covariance) || !finite(s.velocity_covariance)) {
    return false;
  }
  const Eigen::Map<const Eigen::Vector3d> p(s.position.data()), v(s.velocity.data()), w(s.angular_velocity.data());
  const Eigen::Map<const Eigen::Vector4d> q(s.orientation.data());
  return p.norm() < kMaxPosition && v.norm() < kMaxVelocity && w.norm() < kMaxRate && std::abs(q.norm() - 1) < 0.1;
}

float to_float(double value) {
  return static_cast<float>(value);
}

}  // namespace

std::int8_t pose_quality(const PoseSample& s, const OdometryConfig& config) {
  const auto mean = [](double a, double b, double c) { return std::max(0.0, (a + b + c) / 3); };
  const Covariance C = sent_covariance(s, config);
  const double position = mean(C(0, 0), C(1, 1), C(2, 2)) / (kHalfPosition * kHalfPosition);
  const double angle = mean(C(3, 3), C(4, 4), C(5, 5)) / (kHalfAngle * kHalfAngle);
  const double velocity = mean(s.velocity_covariance[0], s.velocity_covariance[4], s.velocity_covariance[8]) /
                          (kHalfVelocity * kHalfVelocity);
  double quality = 100 * s.trust / (1 + position + angle + velocity);
  if (s.state == PoseState::kCoasting) quality *= 0.5;
  return static_cast<std::int8_t>(std::clamp(std::lround(std::isfinite(quality) ? quality : 0.0), 1L, 100L));
}

BodyPose body_pose(const PoseSample& s, const OdometryConfig& config) {
  BodyPose out;
  Eigen::Matrix<double, 6, 1> most;
  most << Eigen::Vector3d::Constant(kUnknownPositionVariance), Eigen::Vector3d::Constant(kUnknownAngleVariance);
  const Eigen::Vector3d most_velocity = Eigen::Vector3d::Constant(kUnknownPositionVariance);
  out.covariance = most.asDiagonal();
  out.velocity_covariance = most_velocity.asDiagonal();
  if (!usable(s)) return out;
  out.attitude_known = s.has_gravity || config.bench_metric;
  out.metric = out.attitude_known && s.has_velocity && (s.has_scale || config.bench_metric);
  if (!out.attitude_known) return out;

  const Eigen::Matrix3d R_world_cam =
      Eigen::Quaterniond(s.orientation[0], s.orientation[1], s.orientation[2], s.orientation[3])
          .normalized()
          .toRotationMatrix();
  const Eigen::Matrix3d L = local_from_world(s, config);
  const Eigen::Matrix3d R_world_body = R_world_cam * config.R_body_cam.transpose();
  const Eigen::Matrix3d R_local_body = L * R_world_body;
  // The body's origin seen from the camera, along world axes. A map without scale (bench_metric) is in units of its
  // own, the arm in metres: they do not go together, and the camera stands for the body.
  const Eigen::Vector3d t_body_cam = s.has_scale ? config.t_body_cam : Eigen::Vector3d::Zero().eval();
  const Eigen::Vector3d arm = R_world_cam * (-config.R_body_cam.transpose() * t_body_cam);

  Eigen::Quaterniond q = Eigen::Quaterniond(R_local_body).normalized();
  if (q.w() < 0) q.coeffs() = -q.coeffs();
  out.q << q.w(), q.x(), q.y(), q.z();
  const Eigen::Vector3d rates_cam(s.angular_velocity.data());
  out.rates = config.R_body_cam * rates_cam;

  // Position of the body = position of the camera + arm; an attitude error e (world axes) moves the arm by e x arm.
  Eigen::Matrix<double, 6, 6> J = Eigen::Matrix<double, 6, 6>::Zero();
  J.topLeftCorner<3, 3>() = L;
  J.topRightCorner<3, 3>() = -L * skew(arm);
  J.bottomRightCorner<3, 3>() = L;
  const Eigen::Matrix<double, 6, 6> rotated = J * sent_covariance(s, config) * J.transpose();
  if (out.metric) {
    out.quality = pose_quality(s, config);
    out.position = L * (Eigen::Vector3d(s.position.data()) + arm);
    if (points_north(s, config)) out.position += Eigen::Vector3d(s.north_moved[0], -s.north_moved[1], 0);
    const Eigen::Vector3d velocity_world = Eigen::Vector3d(s.velocity.data()) + (R_world_cam * rates_cam).cross(arm);
    out.velocity = R_world_body.transpose() * velocity_world;
    const Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> V(s.velocity_covariance.data());
    out.velocity_covariance = R_world_body.transpose() * V * R_world_body;
    out.covariance = rotated;
  } else {
    out.covariance.bottomRightCorner<3, 3>() = rotated.bottomRightCorner<3, 3>();
  }
  tame_covariance<6>(&out.covariance, most);
  tame_covariance<3>(&out.velocity_covariance, most_velocity);
  return out;
}

mavlink::Odometry odometry_message(const BodyPose& pose, const OdometryConfig& config, rt::TimeNs t_capture_ns,
                                   std::uint8_t reset_counter) {
  mavlink::Odometry m;
  m.time_usec = static_cast<std::uint64_t>(std::max<rt::TimeNs>(0, t_capture_ns) / 1000);
  m.x = to_float(pose.position.x());
  m.y = to_float(pose.position.y());
  m.z = to_float(pose.position.z());
  for (int i = 0; i < 4; ++i) m.q[i] = to_float(pose.q(i));
  m.vx = to_float(pose.velocity.x());
  m.vy = to_float(pose.velocity.y());
  m.vz = to_float(pose.velocity.z());
  m.rollspeed = to_float(pose.rates.x());
  m.pitchspeed = to_float(pose.rates.y());
  m.yawspeed = to_float(pose.rates.z());
  std::size_t k = 0;
  for (int row = 0; row < 6; ++row) {
    for (int col = row; col < 6; ++col, ++k) {
      m.pose_covariance[k] = to_float(pose.covariance(row, col));
      const bool velocity = row < 3 && col < 3;
      m.velocity_covariance[k] = velocity ? to_float(pose.velocity_covariance(row, col)) : 0.0F;
    }
  }
  m.frame_id = config.profile == Profile::kArdupilot ? kFrameLocalFrd : kFrameLocalNed;
  m.child_frame_id = kFrameBodyFrd;
  m.reset_counter = reset_counter;
  m.estimator_type = config.inertial ? 3 : 2;  // MAV_ESTIMATOR_TYPE_VIO, _VISION
  m.quality = pose.quality;
  return m;
}

}  // namespace godwit::link
