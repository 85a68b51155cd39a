#include "firmware_app/calibration/camera_calibrator.h"

#include <algorithm>
#include <cmath>
#include <fmt/format.h>
#include <numeric>
#include <opencv2/calib3d.hpp>

#include "firmware_app/calibration/projection.h"

namespace godwit::app {
namespace {

using Distortion = hal::CameraCalibration::Distortion;
constexpr std::size_t kLeastPictures = 5;
constexpr std::size_t kLeastPoints = 8;  ///< of a picture
constexpr int kEnough = 5;               ///< points in a cell

struct Solution {
  hal::CameraCalibration calibration;
  std::vector<Pose> poses;
};

/// Those that differ most from one another, the fullest first.
std::vector<BoardView> choose(std::vector<BoardView> views) {
  std::erase_if(views, [](const BoardView& v) { return v.points.size() < kLeastPoints; });
  if (views.size() <= kMostCalibrationViews) return views;
  std::vector<BoardView> out;
  std::vector<double> distance(views.size(), 1e18);
  std::size_t next = 0;
  for (std::size_t i = 1; i < views.size(); ++i) {
    if (views[i].points.size() > views[next].points.size()) next = i;
  }
  while (out.size() < kMostCalibrationViews) {
    out.push_back(views[next]);
    for (std::size_t i = 0; i < views.size(); ++i)
      distance[i] = std::min(distance[i], mean_distance(views[i], views[next]).value_or(1e9));
    next = std::max_element(distance.begin(), distance.end()) - distance.begin();
    if (distance[next] <= 0) break;
  }
  return out;
}

/// A focal length to begin with: the board's plane in each picture says it (Zhang 2000, by OpenCV), for a fisheye a
/// quarter turn over half the width.
cv::Matx33d first_guess(const std::vector<std::vector<cv::Point3f>>& on_board,
                        const std::vector<std::vector<cv::Point2f>>& in_picture, cv::Size size, Distortion model) {
  const double cx = 0.5 * (size.width - 1), cy = 0.5 * (size.height - 1);
  const double across = size.width / (0.55 * CV_PI);
  if (model == Distortion::kKannalaBrandt4) return {across, 0, cx, 0, across, cy, 0, 0, 1};
  return cv::initCameraMatrix2D(on_board, in_picture, size, 1.0);
}

/// Throws cv::Exception where OpenCV finds no solution.
Solution solve(const Board& board, const std::vector<BoardView>& views, int width, int height, Distortion model) {
  std::vector<std::vector<cv::Point3f>> on_board;
  std::vector<std::vector<cv::Point2f>> in_picture;
  for (const BoardView& v : views) {
    auto& from = on_board.emplace_back();
    auto& to = in_picture.emplace_back();
    for (const BoardPoint& p : v.points) {
      const auto q = board.point(p.id);
      from.emplace_back(static_cast<float>(q[0]), static_cast<float>(q[1]), 0.0F);
      to.emplace_back(static_cast<float>(p.x), static_cast<float>(p.y));
    }
  }
  const cv::Size size(width, height);
  cv::Mat camera(first_guess(on_board, in_picture, size, model)), distortion;
  std::vector<cv::Mat> turns, shifts;
  const cv::TermCriteria until(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 200, 1e-10);
  if (model == Distortion::kKannalaBrandt4) {
    distortion = cv::Mat::zeros(4, 1, CV_64F);
    std::vector<cv::Vec3d> r, t;
    cv::fisheye::calibrate(
        on_board, in_picture, size, camera, distortion, r, t,
        cv::fisheye::CALIB_USE_INTRINSIC_GUESS | cv::fisheye::CALIB_RECOMPUTE_EXTRINSIC | cv::fisheye::CALIB_FIX_SKEW,
        until);
    for (std::size_t i = 0; i < r.size(); ++i) {
      turns.emplace_back(cv::Mat(r[i]).clone());
      shifts.emplace_back(cv::Mat(t[i]).clone());
    }
  } else {
    cv::calibrateCamera(on_board, in_picture, size, camera, distortion, turns, shifts,
                        cv::CALIB_USE_INTRINSIC_GUESS | cv::CALIB_FIX_K3, until);
  }
  Solution out;
  hal::CameraCalibration& c = out.calibration;
  c.width = width;
  c.height = height;
  c.distortion_model = model;
  c.fx = camera.at<double>(0, 0);
  c.fy = camera.at<double>(1, 1);
  c.cx = camera.at<double>(0, 2);
  c.cy = camera.at<double>(1, 2);
  for (std::size_t i = 0; i < 4; ++i) c.distortion[i] = distortion.at<double>(static_cast<int>(i));
  for (std::size_t i = 0; i < turns.size(); ++i) out.poses.push_back({cv::Vec3d(turns[i]), cv::Vec3d(shifts[i])});
  return out;
}

/// Reprojection errors of each point of each picture [pixels].
std::vector<std::vector<double>> errors(const Board& board, const std::vector<BoardView>& views, const Solution& s) {
  std::vector<std::vector<double>> out;
  for (std::size_t i = 0; i < views.size(); ++i) {
    const auto put = project(board, views[i].points, s.calibration, s.poses[i]);
    auto& e = out.emplace_back();
    for (std::size_t k = 0; k < put.size(); ++k) {
      e.push_back(std::hypot(put[k].x - views[i].points[k].x, put[k].y - views[i].points[k].y));
    }
  }
  return out;
}

double rms(const std::vector<double>& e) {
  double sum = 0;
  for (const double x : e) sum += x * x;
  return e.empty() ? 0 : std::sqrt(sum / static_cast<double>(e.size()));
}

/// Leaves out points that are further off than six times the median. How many.
std::size_t leave_out(std::vector<BoardView>* views, const std::vector<std::vector<double>>& e) {
  std::vector<double> all;
  for (const auto& of_view : e) all.insert(all.end(), of_view.begin(), of_view.end());
  std::nth_element(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(all.size() / 2), all.end());
  const double most = std::max(6 * all[all.size() / 2], 0.1);
  std::size_t out = 0;
  for (std::size_t i = 0; i < views->size(); ++i) {
    std::vector<BoardPoint> kept;
    for (std::size_t k = 0; k < e[i].size(); ++k) {
      if (e[i][k] <= most) kept.push_back((*views)[i].points[k]);
    }
    out += e[i].size() - kept.size();
    (*views)[i].points = std::move(kept);
  }
  std::erase_if(*views, [](const BoardView& v) { return v.points.size() < kLeastPoints; });
  return out;
}

double halves_differ(const Board& board, const std::vector<BoardView>& views, const Solution& whole) {
  const hal::CameraCalibration& c = whole.calibration;
  std::array<double, 2> focal{};
  for (std::size_t half = 0; half < 2; ++half) {
    std::vector<BoardView> every_other;
    for (std::size_t i = half; i < views.size(); i += 2) every_other.push_back(views[i]);
    const auto s = solve(board, every_other, c.width, c.height, c.distortion_model);
    focal[half] = 0.5 * (s.calibration.fx + s.calibration.fy);
  }
  return std::abs(focal[0] - focal[1]) / (0.5 * (c.fx + c.fy));
}

}  // namespace

void Coverage::add(const BoardView& view, int width, int height) {
  for (const BoardPoint& p : view.points) {
    const int column = std::clamp(static_cast<int>(p.x * kColumns / width), 0, kColumns - 1);
    const int row = std::clamp(static_cast<int>(p.y * kRows / height), 0, kRows - 1);
    ++points[row * kColumns + column];
  }
}

double Coverage::share() const {
  const auto full = std::count_if(points.begin(), points.end(), [](int n) { return n >= kEnough; });
  return static_cast<double>(full) / (kColumns * kRows);
}

std::vector<std::string> Coverage::drawing() const {
  std::vector<std::string> out;
  for (std::size_t row = 0; row < kRows; ++row) {
    auto& line = out.emplace_back();
    for (std::size_t column = 0; column < kColumns; ++column) {
      const int n = points[row * kColumns + column];
      line += n == 0 ? '.' : n < kEnough ? ':' : '#';
    }
  }
  return out;
}

rt::Result<CalibratedCamera> calibrate_camera(const Board& board, const std::vector<BoardView>& views, int width,
                                              int height, Distortion model) {
  std::vector<BoardView> used = choose(views);
  if (used.size() < kLeastPictures) {
    return rt::Error{fmt::format("the board was found in {} pictures (with {} points and more); {} at least are needed",
                                 used.size(), kLeastPoints, kLeastPictures)};
  }
  try {
    Solution s = solve(board, used, width, height, model);
    CalibratedCamera out;
    out.points_left_out = leave_out(&used, errors(board, used, s));
    if (used.size() < kLeastPictures) return rt::Error{"the pictures do not agree with one another"};
    s = solve(board, used, width, height, model);
    out.calibration = s.calibration;
    out.pictures = used.size();
    const auto e = errors(board, used, s);
    std::vector<double> all;
    for (std::size_t i = 0; i < used.size(); ++i) {
      all.insert(all.end(), e[i].begin(), e[i].end());
      if (rms(e[i]) > out.worst_picture_px) {
        out.worst_picture_px = rms(e[i]);
        out.worst_picture = used[i].name;
      }
      out.coverage.add(used[i], width, height);
      cv::Matx33d turn;
      cv::Rodrigues(s.poses[i].turn, turn);
      out.most_tilt_deg = std::max(out.most_tilt_deg, std::acos(std::min(1.0, std::abs(turn(2, 2)))) * 180 / CV_PI);
    }
    out.points = all.size();
    out.rms_px = rms(all);
    out.halves_differ = used.size() >= 2 * kLeastPictures ? halves_differ(board, used, s) : 1;
    const hal::CameraCalibration& c = out.calibration;
    if (!(c.fx > 0 && c.fy > 0 && std::isfinite(c.fx + c.fy + c.cx + c.cy) && c.cx > 0 && c.cy > 0 &&
          c.cx < width - 1 && c.cy < height - 1)) {
      return rt::Error{"no camera fits these pictures: is it this board, with this many rows and columns?"};
    }
    return out;
  } catch (const cv::Exception& e) {
    return rt::Error{"no camera fits these pictures (all from one side?): " + e.err};
  }
}

std::vector<std::string> verdict(const CalibratedCamera& c) {
  std::vector<std::string> out;
  if (c.rms_px > 0.5) {
    out.push_back(
        fmt::format("points lie {:.2f} pixels off in the mean, more than 0.5: blur, a board that is not flat, "
                    "or another model of the lens",
                    c.rms_px));
  }
  if (c.worst_picture_px > 3 * c.rms_px && c.worst_picture_px > 0.5) {
    out.push_back(fmt::format("{} is off by {:.2f} pixels: leave it out", c.worst_picture, c.worst_picture_px));
  }
  if (c.coverage.share() < 0.75) {
    out.push_back(fmt::format("the board was seen in {:.0f} % of the picture, less than 75: bring it into the corners",
                              100 * c.coverage.share()));
  }
  if (c.most_tilt_deg < 20) {
    out.push_back(
        fmt::format("the board was tilted by {:.0f} degrees at most, less than 20: focal length and distance "
                    "cannot be told apart",
                    c.most_tilt_deg));
  }
  if (c.pictures < 2 * kLeastPictures) {
    out.push_back(fmt::format("{} pictures are few; {} at least", c.pictures, 2 * kLeastPictures));
  } else if (c.halves_differ > 0.003) {
    out.push_back(fmt::format("two halves of the pictures differ by {:.2f} % in the focal length, more than 0.3",
                              100 * c.halves_differ));
  }
  return out;
}

}  // namespace godwit::app
