// Calibration boards drawn as a known camera sees them, with noise; rows may be exposed one after the other.
#pragma once

#include <cmath>
#include <cstdint>
#include <functional>
#include <opencv2/aruco.hpp>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "firmware_app/calibration/board.h"
#include "hal/camera/calibration.h"

namespace godwit::app::drawn {

struct BoardPose {
  cv::Vec3d turn, shift;
};

/// Brightness of the printed side at a place of it [m].
class Print {
 public:
  explicit Print(const Board& board) : board_(board) {
    if (board.kind == Board::Kind::kChessboard) return;
    const auto dictionary = cv::aruco::getPredefinedDictionary(cv::aruco::DICT_APRILTAG_36h11);
    for (int n = 0; n < board.columns * board.rows; ++n) {
      cv::aruco::drawMarker(dictionary, n, 10, tags_.emplace_back(), 2);  // 6 x 6 and two modules of border
    }
  }
  int at(double x, double y) const { return board_.kind == Board::Kind::kChessboard ? square(x, y) : tag(x, y); }

 private:
  int square(double x, double y) const {
    const int column = static_cast<int>(std::floor(x / board_.size_m)),
              row = static_cast<int>(std::floor(y / board_.size_m));
    if (column < -2 || row < -2 || column > board_.columns || row > board_.rows) return 110;
    if (column < -1 || row < -1 || column >= board_.columns || row >= board_.rows) return 230;
    return (column + row) % 2 == 0 ? 25 : 230;
  }
  int tag(double x, double y) const {
    const double step = board_.size_m * (1 + board_.spacing), gap = board_.size_m * board_.spacing;
    if (x < -2 * gap || y < -2 * gap || x > board_.columns * step + gap || y > board_.rows * step + gap) return 110;
    const int column = static_cast<int>(std::floor(x / step)), row = static_cast<int>(std::floor(y / step));
    const double fx = x - column * step, fy = y - row * step;
    // Between the tags' corners Kalibr prints a black square.
    if (fx >= board_.size_m && fy >= board_.size_m) return column >= -1 && row >= -1 ? 25 : 230;
    if (fx >= board_.size_m || fy >= board_.size_m) return 230;
    if (column < 0 || row < 0 || column >= board_.columns || row >= board_.rows) return 230;
    const int module = static_cast<int>(10 * fx / board_.size_m), above = 9 - static_cast<int>(10 * fy / board_.size_m);
    return tags_[static_cast<std::size_t>(row * board_.columns + column)].at<std::uint8_t>(above, module) != 0 ? 230
                                                                                                               : 25;
  }
  Board board_;
  std::vector<cv::Mat> tags_;
};

class Renderer {
 public:
  Renderer(const Board& board, const hal::CameraCalibration& c) : print_(board), c_(c) {
    std::vector<cv::Point2d> pixels;
    for (int y = 0; y < c.height * kFine; ++y) {
      for (int x = 0; x < c.width * kFine; ++x) pixels.emplace_back((x + 0.5) / kFine - 0.5, (y + 0.5) / kFine - 0.5);
    }
    const cv::Matx33d k(c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1);
    if (c.distortion_model == hal::CameraCalibration::Distortion::kKannalaBrandt4) {
      cv::fisheye::undistortPoints(pixels, rays_, k, cv::Vec4d(c.distortion.data()));
    } else {
      cv::undistortPoints(pixels, rays_, k, cv::Vec<double, 5>(c.distortion.data()), cv::noArray(), cv::noArray(),
                          cv::TermCriteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 40, 1e-9));
    }
  }

  /// pose_of: of each row.
  cv::Mat picture(const std::function<BoardPose(int)>& pose_of, std::uint64_t seed) const {
    cv::Mat fine(c_.height * kFine, c_.width * kFine, CV_8UC1), out, noise(c_.height, c_.width, CV_16SC1);
    for (int row = 0; row < c_.height; ++row) {
      const BoardPose pose = pose_of(row);
      cv::Matx33d turn;
      cv::Rodrigues(pose.turn, turn);
      // Where a ray from the camera meets the board: in the board's frame.
      const cv::Matx33d back = turn.t();
      const cv::Vec3d from = back * (-pose.shift);
      for (int y = row * kFine; y < (row + 1) * kFine; ++y) {
        auto* const to = fine.ptr<std::uint8_t>(y);
        for (int x = 0; x < fine.cols; ++x) {
          const cv::Point2d& r = rays_[static_cast<std::size_t>(y * fine.cols + x)];
          const cv::Vec3d ray = back * cv::Vec3d(r.x, r.y, 1);
          const double length = -from[2] / ray[2];
          to[x] = length > 0
                      ? static_cast<std::uint8_t>(print_.at(from[0] + length * ray[0], from[1] + length * ray[1]))
                      : std::uint8_t{110};
        }
      }
    }
    cv::resize(fine, out, {c_.width, c_.height}, 0, 0, cv::INTER_AREA);
    cv::RNG random(seed);
    random.fill(noise, cv::RNG::NORMAL, 0, 2);
    out.convertTo(out, CV_16SC1);
    out += noise;
    out.convertTo(out, CV_8UC1);
    return out;
  }
  BoardView view(const Board& board, const std::function<BoardPose(int)>& pose_of, std::uint64_t seed) const {
    const cv::Mat p = picture(pose_of, seed);
    return {0, "picture " + std::to_string(seed),
            find_board(board, {p.data, p.cols, p.rows, static_cast<int>(p.step)})};
  }

 private:
  static constexpr int kFine = 3;
  Print print_;
  hal::CameraCalibration c_;
  std::vector<cv::Point2d> rays_;
};

/// Board to camera: its printed side towards the camera, tilted about its own axes [deg], its middle seen at (u, v) of
/// the straight picture, so far away.
inline BoardPose pose(const Board& board, double tilt_x, double tilt_y, double roll, double u, double v, double away) {
  const double step = board.size_m * (board.kind == Board::Kind::kAprilGrid ? 1 + board.spacing : 1);
  const cv::Vec3d middle(0.5 * step * board.columns, 0.5 * step * board.rows, 0);
  cv::Matx33d x, y, z;
  cv::Rodrigues(cv::Vec3d(tilt_x * CV_PI / 180, 0, 0), x);
  cv::Rodrigues(cv::Vec3d(0, tilt_y * CV_PI / 180, 0), y);
  cv::Rodrigues(cv::Vec3d(0, 0, roll * CV_PI / 180), z);
  const cv::Matx33d facing(1, 0, 0, 0, -1, 0, 0, 0, -1);
  BoardPose out;
  const cv::Matx33d turn = z * x * y * facing;
  cv::Rodrigues(turn, out.turn);
  out.shift = away * cv::Vec3d(u, v, 1) - turn * middle;
  return out;
}

inline hal::CameraCalibration camera(hal::CameraCalibration::Distortion model) {
  hal::CameraCalibration c;
  c.width = 640;
  c.height = 480;
  c.distortion_model = model;
  const bool fisheye = model == hal::CameraCalibration::Distortion::kKannalaBrandt4;
  c.fx = fisheye ? 286.3 : 451.7;
  c.fy = fisheye ? 285.1 : 450.2;
  c.cx = 323.4;
  c.cy = 236.8;
  if (fisheye) {
    c.distortion = {0.021, -0.013, 0.006, -0.002};
  } else {
    c.distortion = {-0.281, 0.072, 0.0004, -0.0003};
  }
  return c;
}

/// Where the board stands in picture i of those that show a camera: tilted, near and far, and into the corners (of a
/// chessboard every square must be seen).
inline BoardPose shown(const Board& board, const hal::CameraCalibration& c, int i) {
  const bool fisheye = c.distortion_model == hal::CameraCalibration::Distortion::kKannalaBrandt4;
  const double reach = (fisheye ? 0.75 : 0.45) * (board.kind == Board::Kind::kAprilGrid ? 1 : 0.45);
  const double around = 2.4 * i, far = fisheye ? 0.3 + 0.1 * (i % 3) : 0.55 + 0.25 * (i % 3);
  return pose(board, 35 * std::sin(1.7 * i), 35 * std::cos(2.3 * i), 20 * std::sin(i), reach * std::cos(around),
              0.75 * reach * std::sin(around), far);
}

/// The camera swings before the board at 30 Hz, rows are exposed one after the other: where the board stands in a row
/// of picture i.
inline BoardPose swung(const Board& board, const hal::CameraCalibration& c, double readout_s, int i, int row) {
  const double t = i / 30.0 + readout_s * (static_cast<double>(row) / (c.height - 1) - 0.5);
  return pose(board, 15 + 12 * std::sin(5 * t), 15 * std::cos(4 * t), 10 * std::sin(3 * t), 0.25 * std::sin(6 * t),
              0.2 * std::cos(5 * t), 0.75);
}

}  // namespace godwit::app::drawn
