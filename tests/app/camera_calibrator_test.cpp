// Boards are drawn as a known camera sees them; what is found must be that camera.
#include "firmware_app/calibration/camera_calibrator.h"

#include <cmath>
#include <functional>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <opencv2/aruco.hpp>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "hal/camera/calibration_toml.h"

namespace godwit::app {
namespace {

using Distortion = hal::CameraCalibration::Distortion;
using testing::HasSubstr;

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
    if (c.distortion_model == Distortion::kKannalaBrandt4) {
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
      const cv::Vec3d from = turn.t() * (-pose.shift);
      for (int y = row * kFine; y < (row + 1) * kFine; ++y) {
        auto* const to = fine.ptr<std::uint8_t>(y);
        for (int x = 0; x < fine.cols; ++x) {
          const cv::Point2d& r = rays_[static_cast<std::size_t>(y * fine.cols + x)];
          const cv::Vec3d ray = turn.t() * cv::Vec3d(r.x, r.y, 1);
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
BoardPose pose(const Board& board, double tilt_x, double tilt_y, double roll, double u, double v, double away) {
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

hal::CameraCalibration camera(Distortion model) {
  hal::CameraCalibration c;
  c.width = 640;
  c.height = 480;
  c.distortion_model = model;
  const bool fisheye = model == Distortion::kKannalaBrandt4;
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

std::vector<BoardView> views_of(const Board& board, const hal::CameraCalibration& c, int count) {
  const Renderer renderer(board, c);
  const bool fisheye = c.distortion_model == Distortion::kKannalaBrandt4;
  // Into the corners; of a chessboard every square must be seen.
  const double reach = (fisheye ? 0.75 : 0.45) * (board.kind == Board::Kind::kAprilGrid ? 1 : 0.45);
  std::vector<BoardView> out;
  for (int i = 0; i < count; ++i) {
    const double around = 2.4 * i;
    const double far = fisheye ? 0.3 + 0.1 * (i % 3) : 0.55 + 0.25 * (i % 3);
    const BoardPose p = pose(board, 35 * std::sin(1.7 * i), 35 * std::cos(2.3 * i), 20 * std::sin(i),
                             reach * std::cos(around), 0.75 * reach * std::sin(around), far);
    out.push_back(renderer.view(
        board, [&](int) { return p; }, static_cast<std::uint64_t>(i + 1)));
  }
  return out;
}

class CameraCalibrator : public ::testing::TestWithParam<std::pair<const char*, Distortion>> {};

TEST_P(CameraCalibrator, FindsADrawnCameraWithinTwoThousandthsOfItsFocalLength) {
  const auto board = parse_board(GetParam().first);
  ASSERT_TRUE(board.ok());
  const hal::CameraCalibration truth = camera(GetParam().second);
  const auto views = views_of(board.value(), truth, 24);
  const auto found = calibrate_camera(board.value(), views, truth.width, truth.height, truth.distortion_model);
  ASSERT_TRUE(found.ok()) << found.error().message;
  const CalibratedCamera& c = found.value();
  EXPECT_NEAR(c.calibration.fx / truth.fx, 1, 0.002);
  EXPECT_NEAR(c.calibration.fy / truth.fy, 1, 0.002);
  EXPECT_NEAR(c.calibration.cx, truth.cx, 1);
  EXPECT_NEAR(c.calibration.cy, truth.cy, 1);
  EXPECT_LT(c.rms_px, 0.2);
  EXPECT_GT(c.pictures, 15u);
  // A chessboard must be seen whole: it does not get into the corners.
  for (const std::string& wrong : verdict(c)) {
    EXPECT_TRUE(board.value().kind == Board::Kind::kChessboard && wrong.find("corners") != std::string::npos) << wrong;
  }
  std::printf("fx %+.4f %%, fy %+.4f %%, rms %.3f px, %zu pictures, %zu points, covered %.0f %%, halves %.3f %%\n",
              100 * (c.calibration.fx / truth.fx - 1), 100 * (c.calibration.fy / truth.fy - 1), c.rms_px, c.pictures,
              c.points, 100 * c.coverage.share(), 100 * c.halves_differ);
}

INSTANTIATE_TEST_SUITE_P(Boards, CameraCalibrator,
                         ::testing::Values(std::pair{"aprilgrid:6x6:0.055:0.3", Distortion::kRadTan},
                                           std::pair{"aprilgrid:6x6:0.055:0.3", Distortion::kKannalaBrandt4},
                                           std::pair{"chessboard:8x6:0.045", Distortion::kRadTan}),
                         [](const auto& board) {
                           return std::string(board.param.first).substr(0, 5) +
                                  (board.param.second == Distortion::kRadTan ? "_radtan" : "_equidistant");
                         });

TEST(CameraCalibratorVerdict, PicturesThatAreFewOrAlikeAreNotPraised) {
  const Board board = parse_board("aprilgrid:6x6:0.055:0.3").value();
  const hal::CameraCalibration truth = camera(Distortion::kRadTan);
  const Renderer renderer(board, truth);
  std::vector<BoardView> alike;
  for (int i = 0; i < 6; ++i) {
    const BoardPose p = pose(board, 3 + 0.5 * i, -2 - 0.3 * i, 0, 0.01 * i, 0, 0.7);
    alike.push_back(renderer.view(
        board, [&](int) { return p; }, static_cast<std::uint64_t>(i + 1)));
  }
  EXPECT_FALSE(calibrate_camera(board, {alike.begin(), alike.begin() + 3}, 640, 480, Distortion::kRadTan).ok());
  const auto c = calibrate_camera(board, alike, 640, 480, Distortion::kRadTan);
  if (!c.ok()) return;  // refused: as good
  std::string all;
  for (const std::string& wrong : verdict(c.value())) all += wrong + "\n";
  EXPECT_THAT(all, HasSubstr("tilted by"));
  EXPECT_THAT(all, HasSubstr("bring it into the corners"));
  EXPECT_THAT(all, HasSubstr("pictures are few"));
}

/// The camera swings before the board, rows are exposed one after the other.
std::vector<BoardView> swing(const Board& board, const hal::CameraCalibration& c, double readout_s, bool moves) {
  const Renderer renderer(board, c);
  std::vector<BoardView> out;
  for (int i = 0; i < 24; ++i) {
    const auto at = [&](int row) {
      const double t = i / 30.0 + readout_s * (static_cast<double>(row) / (c.height - 1) - 0.5);
      const double s = moves ? 1 : 0;
      return pose(board, 15 + s * 12 * std::sin(5 * t), s * 15 * std::cos(4 * t), s * 10 * std::sin(3 * t),
                  s * 0.25 * std::sin(6 * t), s * 0.2 * std::cos(5 * t), 0.75);
    };
    BoardView v = renderer.view(board, at, static_cast<std::uint64_t>(i + 1));
    v.t_ns = (i + 30) * 33'333'333LL;
    out.push_back(std::move(v));
  }
  return out;
}

TEST(CameraReadout, IsFoundWithinATenthWhereTheMotionShowsIt) {
  const Board board = parse_board("aprilgrid:6x6:0.055:0.3").value();
  const hal::CameraCalibration c = camera(Distortion::kRadTan);
  for (const double truth : {0.02, 0.0}) {
    const auto found = measure_readout(board, swing(board, c, truth, true), c, 0.1);
    ASSERT_TRUE(found) << truth;
    EXPECT_NEAR(found->seconds, truth, std::max(0.1 * truth, 1e-3));
    EXPECT_LT(found->sigma_s, 1e-3);
    std::printf("readout %.2f ms, true %.2f, sigma %.3f\n", 1e3 * found->seconds, 1e3 * truth, 1e3 * found->sigma_s);
  }
  EXPECT_FALSE(measure_readout(board, swing(board, c, 0.02, false), c, 0.1)) << "nothing moves";
}

TEST(Board, AreReadAsTheyAreWritten) {
  const auto grid = parse_board("aprilgrid:5x4:0.1:0.25");
  ASSERT_TRUE(grid.ok());
  EXPECT_EQ(grid.value().points(), 80);
  EXPECT_DOUBLE_EQ(grid.value().point(4 * 6 + 2)[0], 0.125 + 0.1);
  EXPECT_DOUBLE_EQ(grid.value().point(4 * 6 + 2)[1], 0.125 + 0.1);
  const auto squares = parse_board("chessboard:9x6:0.03");
  ASSERT_TRUE(squares.ok());
  EXPECT_DOUBLE_EQ(squares.value().point(10)[1], 0.03);
  for (const char* wrong :
       {"", "grid", "chessboard:9x6", "chessboard:9:0.03", "chessboard:2x6:0.03", "chessboard:9x6:0",
        "aprilgrid:6x6:0.1", "aprilgrid:30x30:0.1:0.3", "aprilgrid:6x6:0.1:0.3:1", "chessboard:9x6:nan"}) {
    const auto board = parse_board(wrong);
    ASSERT_FALSE(board.ok()) << wrong;
    EXPECT_THAT(board.error().message, HasSubstr("is allowed; metres"));
  }
}

}  // namespace
}  // namespace godwit::app
