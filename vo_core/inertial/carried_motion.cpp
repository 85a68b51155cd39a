#include "vo_core/inertial/carried_motion.h"

#include <Eigen/Geometry>
#include <cstddef>

namespace godwit::vo {

using D = DeadReckoning;
static_assert(Motion::kSize == D::kSize);

namespace {

using Map3 = Eigen::Map<Vec3>;
using ConstMap3 = Eigen::Map<const Vec3>;

std::array<double, 4> bytes_of(const Mat3& R) {
  const Eigen::Quaterniond q(R);
  return {q.x(), q.y(), q.z(), q.w()};
}

Mat3 rotation_of(const std::array<double, 4>& q) {
  return Eigen::Quaterniond(q[3], q[0], q[1], q[2]).normalized().toRotationMatrix();
}

}  // namespace

CameraMotion camera_motion(const DeadReckoning& state, const CameraMounting& mounting, const Vec3& rate_rad_s) {
  CameraMotion out;
  const Vec3 arm = state.R * mounting.t_body_cam_m;
  out.T_nav_cam = {state.R * mounting.R_body_cam, state.p + arm};
  out.velocity_m_s = state.v + state.R * rate_rad_s.cross(mounting.t_body_cam_m);
  out.rate_rad_s = mounting.R_body_cam.transpose() * rate_rad_s;
  Eigen::Matrix<double, 6, D::kSize> J = Eigen::Matrix<double, 6, D::kSize>::Zero();
  J.block<3, 3>(0, D::kPlace).setIdentity();
  J.block<3, 3>(0, D::kAttitude) = -skew(arm);
  J.block<3, 3>(3, D::kAttitude).setIdentity();
  const Eigen::Matrix<double, 6, D::kSize> JP = J.lazyProduct(state.P);
  out.covariance = JP.lazyProduct(J.transpose());
  out.velocity_covariance = state.P.block<3, 3>(D::kSpeed, D::kSpeed);
  return out;
}

Vec3 body_rate(const ImuBuffer& readings, rt::TimeNs t_ns, const ImuBias& bias, const ImuNoise& noise) {
  Preintegration around(bias);
  readings.integrate(t_ns - 10 * rt::kNsPerMs, t_ns, noise, &around);
  return around.dt_s() > 0 ? Vec3(so3_log(around.dR(bias.gyro)) / around.dt_s()) : Vec3(Vec3::Zero());
}

Motion motion_of(const DeadReckoning& state, const CameraMounting& mounting, rt::TimeNs t_sensor_ns) {
  Motion out;
  out.known = true;
  out.t_sensor_ns = t_sensor_ns;
  Map3(out.place.data()) = state.p;
  Map3(out.speed.data()) = state.v;
  out.attitude = bytes_of(state.R);
  Map3(out.gyro_bias.data()) = state.bias.gyro;
  Map3(out.accel_bias.data()) = state.bias.accel;
  out.R_body_cam = bytes_of(mounting.R_body_cam);
  Map3(out.t_body_cam.data()) = mounting.t_body_cam_m;
  std::size_t k = 0;
  for (int row = 0; row < D::kSize; ++row) {
    for (int column = row; column < D::kSize; ++column) out.covariance[k++] = state.P(row, column);
  }
  return out;
}

DeadReckoning state_of(const Motion& motion) {
  DeadReckoning out;
  out.p = ConstMap3(motion.place.data());
  out.v = ConstMap3(motion.speed.data());
  out.R = rotation_of(motion.attitude);
  out.bias.gyro = ConstMap3(motion.gyro_bias.data());
  out.bias.accel = ConstMap3(motion.accel_bias.data());
  std::size_t k = 0;
  for (int row = 0; row < D::kSize; ++row) {
    for (int column = row; column < D::kSize; ++column)
      out.P(row, column) = out.P(column, row) = motion.covariance[k++];
  }
  return out;
}

bool carry(const Motion& from, rt::TimeNs t_ns, const ImuBuffer& readings, const DeadReckoningOptions& options,
           CameraMotion* out) {
  if (!from.known || t_ns < from.t_sensor_ns) return false;
  DeadReckoning state = state_of(from);
  if (state.propagate(readings, from.t_sensor_ns, t_ns, options) > 0) return false;
  const CameraMounting mounting{rotation_of(from.R_body_cam), ConstMap3(from.t_body_cam.data())};
  *out = camera_motion(state, mounting, body_rate(readings, t_ns, state.bias, options.imu));
  return true;
}

}  // namespace godwit::vo
