// A body's motion at one picture as it travels to whoever tells it between two pictures.
#pragma once

#include <array>

#include "hal/rt/time.h"

namespace godwit::vo {

/// Dead reckoning's state (vo_core/inertial/dead_reckoning.h) and how the camera sits in the body, as plain bytes: goes
/// through rings. Frame: z up, metres.
struct Motion {
  static constexpr int kSize = 15;  ///< place, speed, attitude, biases of gyroscope and accelerometer
  bool known = false;
  rt::TimeNs t_sensor_ns = 0;                    ///< the picture's time on the inertial sensor's clock
  std::array<double, 3> place{}, speed{};        ///< of the body
  std::array<double, 4> attitude{0, 0, 0, 1};    ///< x y z w, body to frame
  std::array<double, 3> gyro_bias{};             ///< [rad/s]
  std::array<double, 3> accel_bias{};            ///< [m/s^2]
  std::array<double, 4> R_body_cam{0, 0, 0, 1};  ///< x y z w, as known with this picture
  std::array<double, 3> t_body_cam{};
  std::array<double, kSize*(kSize + 1) / 2> covariance{};  ///< upper triangle by rows
};

}  // namespace godwit::vo
