// From an inertial sensor's sample to the reading that the odometry and whoever carries its poses on integrate.
#pragma once

#include "hal/imu/imu.h"
#include "vo_core/inertial/imu_preintegration.h"

namespace godwit::link {

/// t_ns: when it was measured, as the caller has it. The sample must be possible. No allocation.
inline vo::ImuReading imu_reading(const hal::ImuSample& s, rt::TimeNs t_ns) {
  return {t_ns, vo::Vec3(s.gyro_rad_s.data()), vo::Vec3(s.accel_m_s2.data()), (s.flags & hal::kImuGyroSaturated) != 0,
          (s.flags & hal::kImuAccelSaturated) != 0};
}

}  // namespace godwit::link
