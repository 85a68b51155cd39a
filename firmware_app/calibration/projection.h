// A board's points through a calibrated camera, with OpenCV.
#pragma once

#include <opencv2/core.hpp>
#include <vector>

#include "firmware_app/calibration/board.h"
#include "hal/camera/calibration.h"

namespace godwit::app {

/// Board to camera: rotation vector and translation [m].
struct Pose {
  cv::Vec3d turn, shift;
};

/// Pixels of these points of the board. jacobian, where not null: their derivatives by turn and shift, 2 n x 6.
std::vector<cv::Point2d> project(const Board& board, const std::vector<BoardPoint>& points,
                                 const hal::CameraCalibration& c, const Pose& pose, cv::Mat* jacobian = nullptr);

/// The pose that fits the points best, from a nearby one; null: none is known. False: there is none.
bool find_pose(const Board& board, const std::vector<BoardPoint>& points, const hal::CameraCalibration& c, Pose* pose,
               bool nearby);

}  // namespace godwit::app
