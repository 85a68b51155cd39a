#include "firmware_app/sim/flight_calibration.h"

#include <array>

namespace godwit::app {

hal::CameraCalibration calibration_of(const sim::Flight& flight) {
  const sim::CameraPlan& plan = flight.scenario().camera;
  hal::CameraCalibration c;
  c.width = plan.rig.lens.width;
  c.height = plan.rig.lens.height;
  c.fx = plan.rig.lens.fx;
  c.fy = plan.rig.lens.fy;
  c.cx = plan.rig.lens.cx;
  c.cy = plan.rig.lens.cy;
  c.distortion = plan.rig.lens.distortion;
  c.fps = plan.fps;
  c.readout_frames = plan.rig.readout_s * plan.fps;
  std::array<double, 16> T{};
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) T[4 * i + j] = plan.rig.R_body_cam(i, j);
    T[4 * i + 3] = plan.rig.t_body_cam_m[i];
  }
  T[15] = 1;
  c.T_body_cam = T;
  return c;
}

}  // namespace godwit::app
