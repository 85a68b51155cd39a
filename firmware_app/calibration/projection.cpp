#include "firmware_app/calibration/projection.h"

#include <opencv2/calib3d.hpp>

namespace godwit::app {
namespace {

cv::Matx33d camera_matrix(const hal::CameraCalibration& c) {
  return {c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1};
}

cv::Vec4d fisheye(const hal::CameraCalibration& c) {
  return {c.distortion[0], c.distortion[1], c.distortion[2], c.distortion[3]};
}

std::vector<cv::Point3d> on_board(const Board& board, const std::vector<BoardPoint>& points) {
  std::vector<cv::Point3d> out;
  for (const BoardPoint& p : points) {
    const auto q = board.point(p.id);
    out.emplace_back(q[0], q[1], q[2]);
  }
  return out;
}

}  // namespace

std::vector<cv::Point2d> project(const Board& board, const std::vector<BoardPoint>& points,
                                 const hal::CameraCalibration& c, const Pose& pose, cv::Mat* jacobian) {
  std::vector<cv::Point2d> out;
  cv::Mat all;
  if (c.distortion_model == hal::CameraCalibration::Distortion::kKannalaBrandt4) {
    cv::fisheye::projectPoints(on_board(board, points), out, pose.turn, pose.shift, camera_matrix(c), fisheye(c), 0,
                               jacobian != nullptr ? cv::OutputArray(all) : cv::noArray());
    // Columns: focal length, centre, distortion (2 + 2 + 4), then turn and shift.
    if (jacobian != nullptr) *jacobian = all.colRange(8, 14).clone();
  } else {
    const cv::Vec<double, 5> d(c.distortion.data());
    cv::projectPoints(on_board(board, points), pose.turn, pose.shift, camera_matrix(c), d, out,
                      jacobian != nullptr ? cv::OutputArray(all) : cv::noArray());
    if (jacobian != nullptr) *jacobian = all.colRange(0, 6).clone();
  }
  return out;
}

bool find_pose(const Board& board, const std::vector<BoardPoint>& points, const hal::CameraCalibration& c, Pose* pose,
               bool nearby) {
  if (points.size() < 6) return false;
  if (!nearby) {
    std::vector<cv::Point2d> in_picture, straight;
    for (const BoardPoint& p : points) in_picture.emplace_back(p.x, p.y);
    if (c.distortion_model == hal::CameraCalibration::Distortion::kKannalaBrandt4) {
      cv::fisheye::undistortPoints(in_picture, straight, camera_matrix(c), fisheye(c));
    } else {
      cv::undistortPoints(in_picture, straight, camera_matrix(c), cv::Vec<double, 5>(c.distortion.data()));
    }
    if (!cv::solvePnP(on_board(board, points), straight, cv::Matx33d::eye(), cv::noArray(), pose->turn, pose->shift)) {
      return false;
    }
  }
  // Gauss-Newton in the picture itself; it ends where it began when it begins at the minimum.
  for (int i = 0; i < 10; ++i) {
    cv::Mat jacobian;
    const auto put = project(board, points, c, *pose, &jacobian);
    cv::Mat residual(static_cast<int>(2 * points.size()), 1, CV_64F);
    for (std::size_t k = 0; k < points.size(); ++k) {
      residual.at<double>(static_cast<int>(2 * k)) = points[k].x - put[k].x;
      residual.at<double>(static_cast<int>(2 * k + 1)) = points[k].y - put[k].y;
    }
    cv::Mat step;
    if (!cv::solve(jacobian, residual, step, cv::DECOMP_QR)) return false;
    for (int a = 0; a < 3; ++a) {
      pose->turn[a] += step.at<double>(a);
      pose->shift[a] += step.at<double>(3 + a);
    }
    if (cv::norm(step) < 1e-10) break;
  }
  return cv::checkRange(cv::Mat(pose->turn)) && cv::checkRange(cv::Mat(pose->shift)) && pose->shift[2] > 0;
}

}  // namespace godwit::app
