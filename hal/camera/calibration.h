// A camera's calibration as its file says it. Pure function over text; the odometry's own camera model is made of it by
// the application.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <string_view>

#include "hal/rt/result.h"

namespace godwit::hal {

/// Readout of a rolling shutter whose file gives none [frame intervals]. Measured on the Kinect of TUM's fr1_xyz:
/// between 0.6 and 0.8 the first maps' rotation errors are least.
constexpr double kTypicalReadout = 0.7;

/// Pinhole camera with distortion. Pixels: (0, 0) is the centre of the top-left pixel.
struct CameraCalibration {
  enum class Distortion {
    kRadTan,         ///< k1 k2 p1 p2 k3, in OpenCV's order
    kKannalaBrandt4  ///< k1 k2 k3 k4 of the equidistant (fisheye) model
  };

  int width = 0;
  int height = 0;
  double fx = 0, fy = 0, cx = 0, cy = 0;  ///< pixels
  Distortion distortion_model = Distortion::kRadTan;
  std::array<double, 5> distortion{};  ///< unused ones are 0
  int channels = 1;                    ///< of the source's pictures, where the file says it: 1 grey, 3 colour
  double fps = 0;                      ///< nominal; 0: the file does not say
  /// Rolling shutter: time from the first row to the last [frame intervals]; 0: global shutter. Key readout_s; where
  /// only "shutter: rolling .." is said, kTypicalReadout.
  double readout_frames = 0;
  /// The same in seconds; 0 where the file does not say how long a frame interval is.
  double readout_s() const { return fps > 0 ? readout_frames / fps : 0.0; }
  /// Maps camera points into the body (IMU) frame, row major, where the file says it.
  std::optional<std::array<double, 16>> T_body_cam;
  /// What to add to the camera's times to have the IMU's [s], where the file says it (Kalibr's timeshift_cam_imu).
  std::optional<double> time_offset_s;
};

/// Reads our own camera.toml (a name that ends so: table [camera]) and camera.yaml (model, width, height, fx, fy, cx,
/// cy, distortion_model, distortion, ..), EuRoC's sensor.yaml (camera_model, intrinsics, resolution,
/// distortion_coefficients, T_BS, ..), Kalibr's camchain.yaml and camchain-imucam.yaml (cam0), ROS's camera_info or
/// OpenCV's FileStorage (camera_matrix, ..): whichever it is. Error: names the file, the key, its line and the reason;
/// numbers that are not finite or absurd are refused.
rt::Result<CameraCalibration> parse_calibration(std::string_view text, const std::string& name);

}  // namespace godwit::hal
