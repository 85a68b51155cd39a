// Boards are drawn as a known camera sees them; what is found must be that camera.
#include "firmware_app/calibration/camera_calibrator.h"

#include <cmath>
#include <functional>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/app/drawn_board.h"

namespace godwit::app {
namespace {

using Distortion = hal::CameraCalibration::Distortion;
using drawn::BoardPose;
using drawn::Renderer;
using testing::HasSubstr;

std::vector<BoardView> views_of(const Board& board, const hal::CameraCalibration& c, int count) {
  const Renderer renderer(board, c);
  std::vector<BoardView> out;
  for (int i = 0; i < count; ++i) {
    const BoardPose p = drawn::shown(board, c, i);
    out.push_back(renderer.view(
        board, [&](int) { return p; }, static_cast<std::uint64_t>(i + 1)));
  }
  return out;
}

class CameraCalibrator : public ::testing::TestWithParam<std::pair<const char*, Distortion>> {};

TEST_P(CameraCalibrator, FindsADrawnCameraWithinTwoThousandthsOfItsFocalLength) {
  const auto board = parse_board(GetParam().first);
  ASSERT_TRUE(board.ok());
  const hal::CameraCalibration truth = drawn::camera(GetParam().second);
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
  const hal::CameraCalibration truth = drawn::camera(Distortion::kRadTan);
  const Renderer renderer(board, truth);
  std::vector<BoardView> alike;
  for (int i = 0; i < 6; ++i) {
    const BoardPose p = drawn::pose(board, 3 + 0.5 * i, -2 - 0.3 * i, 0, 0.01 * i, 0, 0.7);
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

std::vector<BoardView> swing(const Board& board, const hal::CameraCalibration& c, double readout_s, bool moves) {
  const Renderer renderer(board, c);
  std::vector<BoardView> out;
  for (int i = 0; i < 24; ++i) {
    const BoardPose still = drawn::pose(board, 15, 0, 0, 0, 0, 0.75);
    const auto at = [&](int row) { return moves ? drawn::swung(board, c, readout_s, i, row) : still; };
    BoardView v = renderer.view(board, at, static_cast<std::uint64_t>(i + 1));
    v.t_ns = (i + 30) * 33'333'333LL;
    out.push_back(std::move(v));
  }
  return out;
}

TEST(CameraReadout, IsFoundWithinATenthWhereTheMotionShowsIt) {
  const Board board = parse_board("aprilgrid:6x6:0.055:0.3").value();
  const hal::CameraCalibration c = drawn::camera(Distortion::kRadTan);
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
