#include "vo_core/inertial/inertial_factors.h"

#include <Eigen/Cholesky>
#include <cmath>

namespace godwit::vo {

using S = InertialState;

Eigen::Matrix<double, 3, 2> InertialState::up_basis() const {
  // The axis most at right angles to up; the two columns are d up / d error.
  int k = 0;
  up.cwiseAbs().minCoeff(&k);
  Eigen::Matrix<double, 3, 2> B;
  B.col(0) = up.cross(Vec3::Unit(k)).normalized();
  B.col(1) = up.cross(B.col(0));
  return B;
}

InertialState InertialState::plus(const Error& e) const {
  InertialState out = *this;
  out.R_map_body = Eigen::Quaterniond(R_map_body * so3_exp(e.segment<3>(kRotation))).normalized().toRotationMatrix();
  out.camera += e.segment<3>(kCamera);
  out.velocity += e.segment<3>(kVelocity);
  out.bias.gyro += e.segment<3>(kGyroBias);
  out.bias.accel += e.segment<3>(kAccelBias);
  out.log_scale += e[kScale];
  out.up = (up + up_basis() * e.segment<2>(kUp)).normalized();
  out.mounting += e.segment<3>(kMounting);
  out.time_offset_s += e[kTime];
  out.course += e.segment<3>(kCourse);
  out.picture += e.segment<6>(kPicture);
  return out;
}

InertialState::Error InertialState::minus(const InertialState& from) const {
  Error e;
  e.segment<3>(kRotation) = so3_log(from.R_map_body.transpose() * R_map_body);
  e.segment<3>(kCamera) = camera - from.camera;
  e.segment<3>(kVelocity) = velocity - from.velocity;
  e.segment<3>(kGyroBias) = bias.gyro - from.bias.gyro;
  e.segment<3>(kAccelBias) = bias.accel - from.bias.accel;
  e[kScale] = log_scale - from.log_scale;
  const double along = std::max(0.1, up.dot(from.up));
  e.segment<2>(kUp) = from.up_basis().transpose() * up / along;
  e.segment<3>(kMounting) = mounting - from.mounting;
  e[kTime] = time_offset_s - from.time_offset_s;
  e.segment<3>(kCourse) = course - from.course;
  e.segment<6>(kPicture) = picture - from.picture;
  return e;
}

Vec6 sight_residual(const InertialState& x, const VisionSight& sight, const CameraMounting& m, SightJacobian* J) {
  const Mat3 R_cam = x.R_map_body * m.R_body_cam * so3_exp(x.mounting);
  const Vec3 turned = so3_log(R_cam * sight.R_map_cam.transpose());
  const Vec3 omega = sight.gyro_rad_s - x.bias.gyro;
  const double tau = x.time_offset_s - sight.shift_s, per_s = 1.0 / x.scale();
  const Vec3 lever = omega.cross(m.t_body_cam_m);
  const Vec3 speed = (x.velocity + x.R_map_body * lever) * per_s;  // of the camera [map units/s]
  Vec6 r;
  r.head<3>() = turned + tau * (x.R_map_body * omega);
  r.tail<3>() = x.camera - sight.camera + tau * speed;
  if (sight.shakes()) r -= x.picture;
  if (J == nullptr) return r;
  J->setZero();
  const Mat3 left_inverse = so3_right_jacobian_inverse(-turned);
  J->block<3, 3>(0, S::kRotation) = left_inverse * x.R_map_body - tau * x.R_map_body * skew(omega);
  J->block<3, 3>(0, S::kGyroBias) = -tau * x.R_map_body;
  J->block<3, 3>(0, S::kMounting) = left_inverse * R_cam * so3_right_jacobian(x.mounting);
  J->block<3, 1>(0, S::kTime) = x.R_map_body * omega;
  J->block<3, 3>(3, S::kRotation) = -tau * per_s * x.R_map_body * skew(lever);
  J->block<3, 3>(3, S::kCamera).setIdentity();
  J->block<3, 3>(3, S::kVelocity) = tau * per_s * Mat3::Identity();
  J->block<3, 3>(3, S::kGyroBias) = tau * per_s * x.R_map_body * skew(m.t_body_cam_m);
  J->block<3, 1>(3, S::kScale) = -tau * speed;
  J->block<3, 1>(3, S::kTime) = speed;
  if (sight.shakes()) J->block<6, 6>(0, S::kPicture) = -Mat6::Identity();
  return r;
}

PairResidual pair_residual(const InertialState& i, const InertialState& j, const Preintegration& d,
                           const VisionSight& at_i, const VisionSight& at_j, const CameraMounting& m,
                           const InertialModel& model, PairJacobian* J_i, PairJacobian* J_j) {
  const double dt = d.dt_s(), s = i.scale(), gravity = model.gravity_m_s2;
  const Mat3 R_i_t = i.R_map_body.transpose(), dR = d.dR(i.bias.gyro);
  const Vec3 g = -gravity * i.up;
  const Vec3 turned = so3_log(dR.transpose() * R_i_t * j.R_map_body);
  const Vec3 faster = R_i_t * (j.velocity - i.velocity - g * dt);
  const Mat3 turn = so3_exp(i.course);
  const Vec3 way = s * (j.camera - i.camera), moved = turn * way;
  const Vec3 further = R_i_t * (moved - j.R_map_body * m.t_body_cam_m - i.velocity * dt - 0.5 * dt * dt * g);
  const Eigen::Matrix<double, 3, 2> B_i = i.up_basis();
  SightJacobian V_i, V_j;
  const Vec6 e_i = sight_residual(i, at_i, m, J_i != nullptr ? &V_i : nullptr);
  const Vec6 e_j = sight_residual(j, at_j, m, J_j != nullptr ? &V_j : nullptr);
  PairResidual r;
  r.segment<3>(0) = turned;
  r.segment<3>(3) = faster - d.dv(i.bias);
  r.segment<3>(6) = further + m.t_body_cam_m - d.dp(i.bias);
  r.segment<3>(9) = j.bias.gyro - i.bias.gyro;
  r.segment<3>(12) = j.bias.accel - i.bias.accel;
  r[15] = j.log_scale - i.log_scale;
  r.segment<2>(16) = B_i.transpose() * (j.up - i.up);
  r.segment<3>(18) = j.mounting - i.mounting;
  r[21] = j.time_offset_s - i.time_offset_s;
  const double kept = course_kept(at_i, at_j, dt, model);
  r.segment<3>(22) = j.course - kept * i.course;
  r.segment<6>(25) = e_j - e_i;
  if (J_i == nullptr || J_j == nullptr) return r;
  J_i->setZero();
  J_j->setZero();
  const Mat3 inverse = so3_right_jacobian_inverse(turned);
  const Mat3 R_i_j = R_i_t * j.R_map_body;
  J_i->block<3, 3>(0, S::kRotation) = -inverse * R_i_j.transpose();
  J_j->block<3, 3>(0, S::kRotation) = inverse;
  J_i->block<3, 3>(0, S::kGyroBias) = -inverse * so3_exp(turned).transpose() *
                                      so3_right_jacobian(d.dR_dbg() * (i.bias.gyro - d.bias().gyro)) * d.dR_dbg();
  J_i->block<3, 3>(3, S::kRotation) = skew(faster);
  J_i->block<3, 3>(3, S::kVelocity) = -R_i_t;
  J_j->block<3, 3>(3, S::kVelocity) = R_i_t;
  J_i->block<3, 3>(3, S::kGyroBias) = -d.dv_dbg();
  J_i->block<3, 3>(3, S::kAccelBias) = -d.dv_dba();
  J_i->block<3, 2>(3, S::kUp) = gravity * dt * R_i_t * B_i;
  J_i->block<3, 3>(6, S::kRotation) = skew(further);
  J_j->block<3, 3>(6, S::kRotation) = R_i_j * skew(m.t_body_cam_m);
  J_i->block<3, 3>(6, S::kCamera) = -s * R_i_t * turn;
  J_j->block<3, 3>(6, S::kCamera) = s * R_i_t * turn;
  J_i->block<3, 3>(6, S::kVelocity) = -dt * R_i_t;
  J_i->block<3, 3>(6, S::kGyroBias) = -d.dp_dbg();
  J_i->block<3, 3>(6, S::kAccelBias) = -d.dp_dba();
  J_i->block<3, 1>(6, S::kScale) = R_i_t * moved;
  J_i->block<3, 3>(6, S::kCourse) = -R_i_t * turn * skew(way) * so3_right_jacobian(i.course);
  J_i->block<3, 2>(6, S::kUp) = 0.5 * gravity * dt * dt * R_i_t * B_i;
  for (int k = 0; k < 7; ++k) {
    (*J_i)(9 + k, S::kGyroBias + k) = -1;
    (*J_j)(9 + k, S::kGyroBias + k) = 1;
  }
  J_i->block<2, 2>(16, S::kUp) = -Eigen::Matrix2d::Identity();
  J_j->block<2, 2>(16, S::kUp) = B_i.transpose() * j.up_basis();
  for (int k = 0; k < 7; ++k) {
    (*J_i)(18 + k, S::kMounting + k) = k < 4 ? -1 : -kept;
    (*J_j)(18 + k, S::kMounting + k) = 1;
  }
  J_i->bottomRows<6>() = -V_i;
  J_j->bottomRows<6>() = V_j;
  return r;
}

double position_stray(const VisionSight& sight, const InertialModel& model) {
  return std::hypot(model.position_walk * sight.depth, model.position_stray * std::sqrt(sight.position_rate));
}

double moving_share(const VisionSight& at_i, const VisionSight& at_j, const InertialModel& model) {
  const double moved = std::hypot((at_j.camera - at_i.camera).norm() / at_j.depth,
                                  (at_j.R_map_cam - at_i.R_map_cam).norm() / std::sqrt(2.0));
  return std::clamp(moved / model.still, model.at_rest, 1.0);
}

double course_kept(const VisionSight& at_i, const VisionSight& at_j, double dt_s, const InertialModel& model) {
  const double moving = moving_share(at_i, at_j, model);
  return std::exp(-moving * moving * dt_s / model.course_s);
}

void whiten_pair(const Preintegration& d, const VisionSight& at_i, const VisionSight& at_j, const InertialModel& model,
                 PairResidual* r, PairJacobian* J_i, PairJacobian* J_j) {
  const double root = std::sqrt(d.dt_s());
  const Mat9 L = d.covariance().llt().matrixL();
  // Written out: of a matrix Eigen solves by blocks, which may allocate.
  const auto weigh_together = [&](int first, int rows, const auto& factor) {
    for (int row = 0; row < rows; ++row) {
      const int at = first + row;
      for (int k = 0; k < row; ++k) {
        (*r)[at] -= factor(row, k) * (*r)[first + k];
        J_i->row(at) -= factor(row, k) * J_i->row(first + k);
        J_j->row(at) -= factor(row, k) * J_j->row(first + k);
      }
      (*r)[at] /= factor(row, row);
      J_i->row(at) /= factor(row, row);
      J_j->row(at) /= factor(row, row);
    }
  };
  weigh_together(0, 9, L);
  const auto weigh = [&](int row, int rows, double sigma) {
    r->segment(row, rows) /= sigma;
    J_i->middleRows(row, rows) /= sigma;
    J_j->middleRows(row, rows) /= sigma;
  };
  weigh(9, 3, model.imu.gyro_walk * root);
  weigh(12, 3, model.imu.accel_walk * root);
  // What vision says of how it strays, of the two the worse.
  const double rotation_rate = std::sqrt(std::max(at_i.rotation_rate, at_j.rotation_rate));
  const double position_rate = std::sqrt(std::max(at_i.position_rate, at_j.position_rate));
  const double moving = moving_share(at_i, at_j, model);
  weigh(15, 1, root * moving * std::hypot(model.scale_walk, model.scale_stray * position_rate / at_j.depth));
  weigh(16, 2, root * moving * std::hypot(model.up_walk, model.up_stray * rotation_rate));
  weigh(18, 3, model.mounting_walk * root);
  weigh(21, 1, model.time_walk * root);
  // Where it hardly moves as much as at the least: the rest is in `moving`.
  const double way = std::max((at_j.camera - at_i.camera).norm(), model.still * at_j.depth);
  const auto own = [](const VisionSight& sight) { return sight.shakes() ? 0 : sight.own_position; };
  const double askew = std::max(position_stray(at_i, model), position_stray(at_j, model)) * d.dt_s() / way;
  const double kept = course_kept(at_i, at_j, d.dt_s(), model);
  weigh(22, 3, model.course * askew * std::sqrt(1 - kept * kept));
  weigh(25, 3, root * std::hypot(model.rotation_walk, model.rotation_stray * rotation_rate));
  weigh(28, 3,
        std::hypot(root * model.position_walk * at_i.depth, root * model.position_stray * position_rate,
                   model.own_position * std::hypot(own(at_i), own(at_j))));
  if (!at_j.shakes()) return;
  const Mat6 together = at_j.walk_correlation.llt().matrixL();
  weigh_together(25, 6, together);
}

}  // namespace godwit::vo
