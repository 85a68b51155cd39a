#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>

#include "firmware_app/calibration/camera_calibrator.h"
#include "firmware_app/calibration/projection.h"

namespace godwit::app {
namespace {

constexpr std::size_t kLeastPointsOfAView = 12;
constexpr double kMostSigmaS = 1e-3;
/// Points that move by less in the mean [pixels/s] are bent by a third of a pixel at most.
constexpr double kStillPixelsS = 10;
constexpr std::size_t kEnoughStill = 10;
constexpr double kSettled = 0.003;  ///< of the readout, from round to round
constexpr int kRounds = 12;

struct Moment {
  double t_s = 0;
  bool good = false;
  Pose pose;                       ///< at the middle row
  std::vector<BoardPoint> points;  ///< as seen
};

/// How fast each point moves in the picture [pixels/s], by the poses around; empty: nobody knows.
std::vector<cv::Point2d> velocities(const Board& board, const hal::CameraCalibration& c, const Moment& before,
                                    const Moment& now, const Moment& after) {
  // Poses at equal distances in time on both sides: what bends the path in between falls out.
  Pose ahead = now.pose, behind = now.pose;
  const double dt = 0.5 * std::min(now.t_s - before.t_s, after.t_s - now.t_s);
  for (int a = 0; a < 3; ++a) {
    const double turn = (after.pose.turn[a] - before.pose.turn[a]) / (after.t_s - before.t_s);
    const double shift = (after.pose.shift[a] - before.pose.shift[a]) / (after.t_s - before.t_s);
    ahead.turn[a] += dt * turn;
    behind.turn[a] -= dt * turn;
    ahead.shift[a] += dt * shift;
    behind.shift[a] -= dt * shift;
  }
  auto out = project(board, now.points, c, ahead);
  const auto from = project(board, now.points, c, behind);
  for (std::size_t i = 0; i < out.size(); ++i) out[i] = (out[i] - from[i]) * (0.5 / dt);
  return out;
}

/// The part of v that the pose of one picture cannot explain.
cv::Mat beside_pose(const cv::Mat& jacobian, const cv::Mat& v) {
  cv::Mat x;
  cv::solve(jacobian, v, x, cv::DECOMP_QR);
  return v - jacobian * x;
}

/// Mean speed of the points that both views show [pixels/s]; nothing: they are too far apart in time, or share none.
std::optional<double> speed(const BoardView& a, const BoardView& b, double max_gap_s) {
  const double dt_s = std::abs(rt::to_seconds(b.t_ns - a.t_ns));
  if (a.t_ns == 0 || b.t_ns == 0 || !(dt_s > 0) || dt_s > max_gap_s) return std::nullopt;
  const std::optional<double> moved = mean_distance(a, b);
  if (!moved) return std::nullopt;
  return *moved / dt_s;
}

/// Against those before and behind; a picture without such is taken to be still.
bool is_still(const std::vector<BoardView>& views, std::size_t i, double max_gap_s) {
  const bool moves_before = i > 0 && speed(views[i - 1], views[i], max_gap_s).value_or(0) > kStillPixelsS;
  return !moves_before &&
         (i + 1 == views.size() || speed(views[i], views[i + 1], max_gap_s).value_or(0) <= kStillPixelsS);
}

}  // namespace

std::optional<Readout> measure_readout(const Board& board, const std::vector<BoardView>& views,
                                       const hal::CameraCalibration& c, double max_gap_s,
                                       std::vector<BoardView>* straight) {
  std::vector<Moment> moments;
  for (const BoardView& v : views) {
    Moment m{rt::to_seconds(v.t_ns), false, {}, v.points};
    m.good = v.t_ns != 0 && v.points.size() >= kLeastPointsOfAView && find_pose(board, v.points, c, &m.pose, false);
    moments.push_back(std::move(m));
  }
  double readout = 0;
  Readout out;
  // The poses are wrong by what the readout does to them: with each round less.
  for (int round = 0; round < 6; ++round) {
    double shown = 0, power = 0, scatter = 0;
    std::size_t equations = 0;
    out.pictures = 0;
    std::vector<std::vector<BoardPoint>> straightened(moments.size());
    for (std::size_t i = 1; i + 1 < moments.size(); ++i) {
      const Moment &a = moments[i - 1], &b = moments[i], &d = moments[i + 1];
      const double turned = cv::norm(a.pose.turn - d.pose.turn);
      if (!a.good || !b.good || !d.good || !(b.t_s > a.t_s) || !(d.t_s > b.t_s) || b.t_s - a.t_s > max_gap_s ||
          d.t_s - b.t_s > max_gap_s || turned > 1) {
        continue;
      }
      const auto v = velocities(board, c, a, b, d);
      cv::Mat jacobian;
      const auto put = project(board, b.points, c, b.pose, &jacobian);
      const int n = static_cast<int>(put.size());
      cv::Mat late(2 * n, 1, CV_64F), off(2 * n, 1, CV_64F);
      straightened[i] = b.points;
      for (int k = 0; k < n; ++k) {
        const double row = b.points[k].y / (c.height - 1) - 0.5;
        late.at<double>(2 * k) = v[k].x * row;
        late.at<double>(2 * k + 1) = v[k].y * row;
        off.at<double>(2 * k) = b.points[k].x - put[k].x;
        off.at<double>(2 * k + 1) = b.points[k].y - put[k].y;
        straightened[i][k].x -= readout * v[k].x * row;
        straightened[i][k].y -= readout * v[k].y * row;
      }
      const cv::Mat model = beside_pose(jacobian, late), seen = beside_pose(jacobian, off);
      shown += model.dot(seen);
      power += model.dot(model);
      scatter += seen.dot(seen);
      equations += 2 * n - 6;
      ++out.pictures;
    }
    if (out.pictures < 10 || !(power > 0)) return std::nullopt;
    readout = shown / power;
    const double left = std::max(0.0, scatter - shown * readout) / static_cast<double>(equations);
    out.seconds = readout;
    out.sigma_s = std::sqrt(left / power);
    if (straight != nullptr) {
      straight->clear();
      for (std::size_t i = 0; i < views.size(); ++i) {
        if (straightened[i].empty() && !is_still(views, i, max_gap_s)) continue;
        straight->push_back(views[i]);
        if (!straightened[i].empty()) straight->back().points = straightened[i];
      }
    }
    for (std::size_t i = 0; i < moments.size(); ++i) {
      if (!straightened[i].empty() && !find_pose(board, straightened[i], c, &moments[i].pose, true)) {
        moments[i].good = false;
      }
    }
  }
  if (out.sigma_s > kMostSigmaS) return std::nullopt;
  return out;
}

rt::Result<CameraAndReadout> calibrate_camera_and_readout(const Board& board, const std::vector<BoardView>& views,
                                                          int width, int height,
                                                          hal::CameraCalibration::Distortion model, double max_gap_s) {
  const auto calibrate = [&](const std::vector<BoardView>& by) {
    return calibrate_camera(board, by, width, height, model);
  };
  auto all = calibrate(views);
  if (!all) return all.error();
  CameraAndReadout out{std::move(all).value(), std::nullopt};
  // What is still is bent by no shutter: the better camera to begin with.
  hal::CameraCalibration begin = out.camera.calibration;
  std::vector<BoardView> still;
  for (std::size_t i = 0; i < views.size(); ++i) {
    if (is_still(views, i, max_gap_s)) still.push_back(views[i]);
  }
  if (still.size() >= kEnoughStill && still.size() < views.size()) {
    if (const auto by_still = calibrate(still)) begin = by_still.value().calibration;
  }
  std::vector<BoardView> straight;
  out.readout = measure_readout(board, views, begin, max_gap_s, &straight);
  for (int round = 0; round < kRounds && out.readout && out.readout->rolling(); ++round) {
    auto better = calibrate(straight);
    if (!better) break;
    out.camera = std::move(better).value();
    const double before_s = out.readout->seconds;
    const auto again = measure_readout(board, views, out.camera.calibration, max_gap_s, &straight);
    if (!again) break;
    out.readout = again;
    if (std::abs(again->seconds - before_s) < kSettled * before_s) break;
  }
  return out;
}

}  // namespace godwit::app
