// Calibrations that the tests share: published ones, and a made-up fisheye.
#pragma once

#include "vo_core/geometry/camera_model.h"

namespace godwit::vo::test {

/// The TUM RGB-D benchmark's freiburg1 camera, whose strong k2 and k3 nearly cancel.
inline CameraModel tum_fr1() {
  return CameraModel::pinhole_radtan(640, 480, 517.306408, 516.469215, 318.64304, 255.313989,
                                     {0.262383, -0.953104, -0.005358, 0.002628, 1.163314})
      .value();
}

/// EuRoC MAV, left camera.
inline CameraModel euroc() {
  return CameraModel::pinhole_radtan(752, 480, 458.654, 457.296, 367.215, 248.375,
                                     {-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05, 0.0})
      .value();
}

/// A fisheye with about 150 degrees across.
inline CameraModel fisheye() {
  return CameraModel::kannala_brandt(640, 480, 260.0, 259.0, 321.5, 238.25, {-0.012, 0.021, -0.014, 0.0031}).value();
}

}  // namespace godwit::vo::test
