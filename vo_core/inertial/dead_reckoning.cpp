#include "vo_core/inertial/dead_reckoning.h"

namespace godwit::vo {

void DeadReckoning::correct(const Error& e) {
  p += e.segment<3>(kPlace);
  v += e.segment<3>(kSpeed);
  R = so3_exp(e.segment<3>(kAttitude)) * R;
  R = Eigen::Quaterniond(R).normalized().toRotationMatrix();
  bias.gyro += e.segment<3>(kGyroBias);
  bias.accel += e.segment<3>(kAccelBias);
}

rt::TimeNs DeadReckoning::propagate(const ImuBuffer& readings, rt::TimeNs t0_ns, rt::TimeNs t1_ns,
                                    const DeadReckoningOptions& options) {
  if (t1_ns <= t0_ns) return 0;
  Preintegration d(bias);
  rt::TimeNs missing_ns = readings.integrate(t0_ns, t1_ns, options.imu, &d).missing_ns;
  if (missing_ns <= options.held_ns) missing_ns = 0;
  const bool measured = missing_ns == 0 && d.dt_s() > 0;
  const double dt = rt::to_seconds(t1_ns - t0_ns);

  Matrix F = Matrix::Identity();
  F.block<3, 3>(kPlace, kSpeed) = dt * Mat3::Identity();
  if (measured) {
    const Vec3 g(0, 0, -options.gravity_m_s2);
    const Vec3 dv = R * d.dv(bias), dp = R * d.dp(bias);
    const Mat3 R_new = R * d.dR(bias.gyro);
    F.block<3, 3>(kAttitude, kGyroBias) = R_new * d.dR_dbg();
    F.block<3, 3>(kSpeed, kAttitude) = -skew(dv);
    F.block<3, 3>(kSpeed, kGyroBias) = R * d.dv_dbg();
    F.block<3, 3>(kSpeed, kAccelBias) = R * d.dv_dba();
    F.block<3, 3>(kPlace, kAttitude) = -skew(dp);
    F.block<3, 3>(kPlace, kGyroBias) = R * d.dp_dbg();
    F.block<3, 3>(kPlace, kAccelBias) = R * d.dp_dba();
    // The covariance of (rotation right of dR, dv, dp) in our order and axes.
    Eigen::Matrix<double, 9, 9> J = Eigen::Matrix<double, 9, 9>::Zero();
    J.block<3, 3>(kPlace, 6) = R;
    J.block<3, 3>(kSpeed, 3) = R;
    J.block<3, 3>(kAttitude, 0) = R_new;
    const Mat9 turned = J.lazyProduct(d.covariance());
    const Mat9 noise = turned.lazyProduct(J.transpose());
    const Matrix carried = F.lazyProduct(P);
    P = carried.lazyProduct(F.transpose());
    P.topLeftCorner<9, 9>() += noise;
    p += v * dt + 0.5 * dt * dt * g + dp;
    v += g * dt + dv;
    R = Eigen::Quaterniond(R_new).normalized().toRotationMatrix();
  } else {
    const Matrix carried = F.lazyProduct(P);
    P = carried.lazyProduct(F.transpose());
    // Densities, so that many short steps say the same as one long one.
    const double force = options.unknown_speed_m_s * options.unknown_speed_m_s;
    P.diagonal().segment<3>(kPlace).array() += force * dt * dt * dt / 3;
    P.diagonal().segment<3>(kSpeed).array() += force * dt;
    P.diagonal().segment<3>(kAttitude).array() += options.unknown_turn_rad * options.unknown_turn_rad * dt;
    P.block<3, 3>(kPlace, kSpeed) += 0.5 * force * dt * dt * Mat3::Identity();
    P.block<3, 3>(kSpeed, kPlace) += 0.5 * force * dt * dt * Mat3::Identity();
    p += v * dt;
    missing_ns = t1_ns - t0_ns;
  }
  P.diagonal().segment<3>(kGyroBias).array() += options.imu.gyro_walk * options.imu.gyro_walk * dt;
  P.diagonal().segment<3>(kAccelBias).array() += options.imu.accel_walk * options.imu.accel_walk * dt;
  P = (0.5 * (P + P.transpose())).eval();
  return missing_ns;
}

}  // namespace godwit::vo
