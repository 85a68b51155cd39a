#include "firmware_app/link/pose_carrier.h"

#include <Eigen/Geometry>
#include <algorithm>

#include "firmware_app/link/imu_reading.h"

namespace godwit::link {

void PoseCarrier::hear() {
  hal::ImuSample sample;
  for (std::size_t i = 0; i < ReadingRing::capacity() && readings_->pop(&sample); ++i) {
    if (hal::possible(sample)) buffer_.add(imu_reading(sample, sample.t_ns));
  }
}

rt::TimeNs PoseCarrier::reaches(const PoseSample& from) const {
  if (!vo::claims_pose(from.state) || !from.has_scale || !from.has_gravity || !from.motion.known || buffer_.empty())
    return 0;
  const rt::TimeNs measured_ns = buffer_.newest_ns() - from.motion.t_sensor_ns;
  return measured_ns > 0 ? from.t_capture_ns + std::min(measured_ns, options_.horizon_ns) : 0;
}

bool PoseCarrier::carry(const PoseSample& from, rt::TimeNs t_ns, PoseSample* out) const {
  const rt::TimeNs reach_ns = reaches(from);
  if (reach_ns == 0 || t_ns < from.t_capture_ns || t_ns > reach_ns) return false;
  vo::CameraMotion camera;
  const rt::TimeNs t_sensor_ns = from.motion.t_sensor_ns + (t_ns - from.t_capture_ns);
  if (!vo::carry(from.motion, t_sensor_ns, buffer_, options_.inertial, &camera)) return false;
  *out = from;
  out->t_capture_ns = t_ns;
  out->t_published_ns = 0;  // how long it took to be sent is a measured pose's figure
  Eigen::Map<vo::Vec3>(out->position.data()) = camera.T_nav_cam.t;
  const Eigen::Quaterniond q = camera.T_nav_cam.quaternion();
  out->orientation = {q.w(), q.x(), q.y(), q.z()};
  Eigen::Map<vo::Vec3>(out->velocity.data()) = camera.velocity_m_s;
  Eigen::Map<vo::Vec3>(out->angular_velocity.data()) = camera.rate_rad_s;
  Eigen::Map<Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(out->covariance.data()) = camera.covariance;
  Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(out->velocity_covariance.data()) =
      camera.velocity_covariance;
  // The heading from north has grown by as much as that in the frame.
  out->heading_variance += std::max(0.0, out->covariance.back() - from.covariance.back());
  return true;
}

}  // namespace godwit::link
