#include "firmware_app/calibration/board.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <opencv2/aruco.hpp>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

namespace godwit::app {
namespace {

/// False: not a number as a whole.
template <typename Number>
bool read(const std::string& text, Number* out) {
  const auto result = std::from_chars(text.data(), text.data() + text.size(), *out);
  return result.ec == std::errc() && result.ptr == text.data() + text.size();
}

std::vector<std::string> split(const std::string& text, char by) {
  std::vector<std::string> out;
  for (std::size_t at = 0; at <= text.size();) {
    const std::size_t end = std::min(text.find(by, at), text.size());
    out.push_back(text.substr(at, end - at));
    at = end + 1;
  }
  return out;
}

cv::Mat as_mat(const rt::ImageView& grey) {
  return cv::Mat(grey.height, grey.width, CV_8UC1, const_cast<std::uint8_t*>(grey.data), grey.stride);
}

/// Corners of black squares that meet, to a hundredth of a pixel: within a third of the way to the nearest other one,
/// so that no second corner pulls.
void refine(const cv::Mat& grey, std::vector<cv::Point2f>* corners, float spacing_px) {
  const int half = std::clamp(static_cast<int>(spacing_px / 3), 2, 8);
  cv::cornerSubPix(grey, *corners, {half, half}, {-1, -1},
                   {cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 60, 0.002});
}

std::vector<BoardPoint> find_chessboard(const Board& board, const cv::Mat& grey) {
  std::vector<cv::Point2f> corners;
  if (!cv::findChessboardCorners(
          grey, {board.columns, board.rows}, corners,
          cv::CALIB_CB_ADAPTIVE_THRESH | cv::CALIB_CB_NORMALIZE_IMAGE | cv::CALIB_CB_FAST_CHECK)) {
    return {};
  }
  float nearest = 1e9F;
  for (std::size_t i = 1; i < corners.size(); ++i) {
    nearest = std::min(nearest, static_cast<float>(cv::norm(corners[i] - corners[i - 1])));
  }
  refine(grey, &corners, nearest);
  std::vector<BoardPoint> out;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    // The detector goes by rows downwards in the picture.
    const int column = static_cast<int>(i) % board.columns, row = board.rows - 1 - static_cast<int>(i) / board.columns;
    out.push_back({row * board.columns + column, corners[i].x, corners[i].y});
  }
  return out;
}

/// Corner k of the detected quadrangle is corner (turn + k) of the tag as Board counts; tags are numbered by rows
/// upwards, or downwards.
struct Reading {
  int turn = 0;
  bool downwards = false;
};

int point_of(const Board& board, const Reading& reading, int tag, int corner) {
  const int row = tag / board.columns, column = tag % board.columns;
  const int n = (reading.downwards ? board.rows - 1 - row : row) * board.columns + column;
  // Detected clockwise, counted against the clock.
  return 4 * n + (reading.turn + 4 - corner) % 4;
}

/// Mean distance [pixels] of the corners from where one plane puts them.
double misfit(const Board& board, const Reading& reading, const std::vector<int>& ids,
              const std::vector<std::vector<cv::Point2f>>& corners) {
  std::vector<cv::Point2f> on_board, in_picture, put;
  for (std::size_t i = 0; i < ids.size(); ++i) {
    for (int k = 0; k < 4; ++k) {
      const auto p = board.point(point_of(board, reading, ids[i], k));
      on_board.emplace_back(static_cast<float>(p[0]), static_cast<float>(p[1]));
      in_picture.push_back(corners[i][k]);
    }
  }
  const cv::Mat plane = cv::findHomography(on_board, in_picture);
  if (plane.empty()) return 1e9;
  cv::perspectiveTransform(on_board, put, plane);
  double sum = 0;
  for (std::size_t i = 0; i < put.size(); ++i) sum += cv::norm(put[i] - in_picture[i]);
  return sum / static_cast<double>(put.size());
}

std::vector<BoardPoint> find_grid(const Board& board, const cv::Mat& grey) {
  static const auto dictionary = cv::aruco::getPredefinedDictionary(cv::aruco::DICT_APRILTAG_36h11);
  std::vector<int> ids;
  std::vector<std::vector<cv::Point2f>> corners;
  // Kalibr prints tags with a border of two bits, others with one.
  for (const int border : {2, 1}) {
    const auto parameters = cv::aruco::DetectorParameters::create();
    parameters->markerBorderBits = border;
    parameters->cornerRefinementMethod = cv::aruco::CORNER_REFINE_NONE;
    std::vector<int> found;
    std::vector<std::vector<cv::Point2f>> at;
    cv::aruco::detectMarkers(grey, dictionary, at, found, parameters);
    if (found.size() <= ids.size()) continue;
    ids = std::move(found);
    corners = std::move(at);
  }
  for (std::size_t i = ids.size(); i-- > 0;) {
    if (ids[i] < board.columns * board.rows && std::count(ids.begin(), ids.end(), ids[i]) == 1) continue;
    ids.erase(ids.begin() + static_cast<std::ptrdiff_t>(i));
    corners.erase(corners.begin() + static_cast<std::ptrdiff_t>(i));
  }
  if (ids.size() < 2) return {};
  // Makers of boards differ in which way up a tag is; only one reading fits a plane.
  Reading best;
  double least = 1e9, second = 1e9;
  for (const bool downwards : {false, true}) {
    for (int turn = 0; turn < 4; ++turn) {
      const double off = misfit(board, {turn, downwards}, ids, corners);
      if (off >= least) {
        second = std::min(second, off);
        continue;
      }
      second = least;
      least = off;
      best = {turn, downwards};
    }
  }
  // A fisheye bends the plane by some pixels, another reading turns every tag.
  if (least > 0.6 * second) return {};
  std::vector<BoardPoint> out;
  for (std::size_t i = 0; i < ids.size(); ++i) {
    const auto side = static_cast<float>(cv::arcLength(corners[i], true) / 4);
    const double tilt = std::sqrt(cv::contourArea(corners[i]));
    if (side > 3 * tilt) continue;  // seen from so far aside that its corners run together
    std::vector<cv::Point2f> refined = corners[i];
    refine(grey, &refined,
           static_cast<float>(std::min(static_cast<double>(side), tilt) * std::max(board.spacing, 0.15)) * 2);
    for (int k = 0; k < 4; ++k) {
      const cv::Point2f& p = refined[k];
      if (cv::norm(p - corners[i][k]) > 0.2 * static_cast<double>(side)) continue;
      out.push_back({point_of(board, best, ids[i], k), p.x, p.y});
    }
  }
  return out;
}

}  // namespace

std::array<double, 3> Board::point(int id) const {
  const auto place = [this](int nth, double step) {
    const int column = nth % columns, row = nth / columns;
    return std::array<double, 3>{step * column, step * row, 0};
  };
  if (kind == Kind::kChessboard) return place(id, size_m);
  const int tag = id / 4, corner = id % 4;
  const double step = size_m * (1 + spacing);
  const double right = corner == 1 || corner == 2 ? size_m : 0, up = corner >= 2 ? size_m : 0;
  const std::array<double, 3> lowest = place(tag, step);
  return {lowest[0] + right, lowest[1] + up, 0};
}

rt::Result<Board> parse_board(const std::string& text) {
  const auto parts = split(text, ':');
  Board out;
  const bool grid = parts[0] == "aprilgrid";
  out.kind = grid ? Board::Kind::kAprilGrid : Board::Kind::kChessboard;
  const auto size = split(parts.size() > 1 ? parts[1] : "", 'x');
  const bool good = (grid || parts[0] == "chessboard") && parts.size() == (grid ? 4U : 3U) && size.size() == 2 &&
                    read(size[0], &out.columns) && read(size[1], &out.rows) && read(parts[2], &out.size_m) &&
                    (!grid || read(parts[3], &out.spacing));
  const int least = grid ? 1 : 3;
  if (good && out.columns >= least && out.rows >= least && out.columns <= 50 && out.rows <= 50 && out.size_m > 1e-4 &&
      out.size_m < 10 && (!grid || (out.spacing >= 0 && out.spacing <= 2 && out.columns * out.rows <= 587))) {
    return out;
  }
  return rt::Error{"board '" + text +
                   "': aprilgrid:COLUMNSxROWS:TAG:SPACING (such as aprilgrid:6x6:0.088:0.3) or "
                   "chessboard:COLUMNSxROWS:SQUARE (inner corners, such as chessboard:9x6:0.025) is allowed; metres"};
}

std::vector<BoardPoint> find_board(const Board& board, const rt::ImageView& grey) {
  const cv::Mat picture = as_mat(grey);
  auto out = board.kind == Board::Kind::kChessboard ? find_chessboard(board, picture) : find_grid(board, picture);
  std::sort(out.begin(), out.end(), [](const BoardPoint& a, const BoardPoint& b) { return a.id < b.id; });
  return out;
}

std::optional<double> mean_distance(const BoardView& a, const BoardView& b) {
  double sum = 0;
  int shared = 0;
  auto at = b.points.begin();
  for (const BoardPoint& p : a.points) {
    while (at != b.points.end() && at->id < p.id) ++at;
    if (at == b.points.end() || at->id != p.id) continue;
    sum += std::hypot(p.x - at->x, p.y - at->y);
    ++shared;
  }
  if (shared == 0) return std::nullopt;
  return sum / shared;
}

}  // namespace godwit::app
