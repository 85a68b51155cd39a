// What the gyroscope tells the tracker: how the camera turned between two pictures, and while one was read.
#include <array>

#include "vo_core/inertial/inertial_odometry.h"

namespace godwit::vo {

bool InertialOdometry::camera_turn(rt::TimeNs t_ref_ns, rt::TimeNs t_cur_ns, Mat3* R_cur_ref) const {
  if (buffer_.empty() || !metric()) return false;  // before, the gyroscope's bias is not known
  const InertialState& x = smoother_.newest();
  const rt::TimeNs shift = static_cast<rt::TimeNs>(x.time_offset_s * 1e9);
  Preintegration d(x.bias);
  const auto covered = buffer_.integrate(t_ref_ns + shift, t_cur_ns + shift, options_.model.imu, &d);
  if (covered.missing_ns > 10 * rt::kNsPerMs || covered.gyro_saturated) return false;
  const Mat3 R_body_cam = smoother_.mounting().R_body_cam * so3_exp(x.mounting);
  *R_cur_ref = R_body_cam.transpose() * d.dR(x.bias.gyro).transpose() * R_body_cam;
  return true;
}

bool InertialOdometry::row_turns(rt::TimeNs t_before_ns, rt::TimeNs t_ns, RowTurns* turns, RowTurns* rates) const {
  std::array<Vec3, RowTurns::kRows> turned, rate;
  if (!buffer_.row_turns(t_before_ns, t_ns, options_.readout_ns, turned, rate)) return false;
  const Mat3 R_cam_body = -smoother_.mounting().R_body_cam.transpose();
  for (int k = 0; k < RowTurns::kRows; ++k) {
    turns->at[k] = (R_cam_body * turned[k]).cast<float>();
    rates->at[k] = (R_cam_body * rate[k]).cast<float>();
  }
  return true;
}

}  // namespace godwit::vo
