// Intrinsics of a camera from pictures of a board, how far they are to be trusted, and the readout of a rolling
// shutter.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "firmware_app/calibration/board.h"
#include "hal/camera/calibration.h"

namespace godwit::app {

/// Where in the picture points were seen.
struct Coverage {
  static constexpr int kColumns = 8, kRows = 6;
  std::array<int, kColumns * kRows> points{};

  void add(const BoardView& view, int width, int height);
  /// Share of the cells with at least five points.
  double share() const;
  /// A line of text for each row, a character a cell: '.' none, ':' few, '#' enough.
  std::vector<std::string> drawing() const;
};

struct CalibratedCamera {
  hal::CameraCalibration calibration;
  std::size_t pictures = 0, points = 0;
  std::size_t points_left_out = 0;  ///< further off than their like
  double rms_px = 0;                ///< of the reprojection, both axes together
  double worst_picture_px = 0;      ///< the same of the worst picture
  std::string worst_picture;
  double most_tilt_deg = 0;  ///< between the board's plane and the picture's
  double halves_differ = 0;  ///< focal lengths of two calibrations, each from every other picture, over their mean
  Coverage coverage;
};

/// At most so many pictures go into one calibration: those that differ most.
constexpr std::size_t kMostCalibrationViews = 60;

/// Error: too few pictures, all alike, or no solution; in words. The views' order does not matter.
rt::Result<CalibratedCamera> calibrate_camera(const Board& board, const std::vector<BoardView>& views, int width,
                                              int height, hal::CameraCalibration::Distortion model);

/// What is wrong with it, in words, worst first; empty: nothing, it may be flown.
std::vector<std::string> verdict(const CalibratedCamera& c);

struct Readout {
  double seconds = 0;  ///< first row to last
  double sigma_s = 0;  ///< its standard deviation, by the pictures' own scatter
  std::size_t pictures = 0;
  /// More than a global shutter's would come out by chance.
  bool rolling() const { return seconds > 3 * sigma_s && seconds > 1e-3; }
};

/// How long the rows' exposures last, from pictures of a board before which the camera moves: rows further down show it
/// later. Views in the order of their times, at most max_gap_s from one to the next where they are to count. Nothing:
/// the motion does not show it (sigma above a thousandth of a second). straight, where not null: the views as a global
/// shutter would have seen them; those that move and of which nobody knows how are left out.
std::optional<Readout> measure_readout(const Board& board, const std::vector<BoardView>& views,
                                       const hal::CameraCalibration& calibration, double max_gap_s,
                                       std::vector<BoardView>* straight = nullptr);

struct CameraAndReadout {
  CalibratedCamera camera;
  std::optional<Readout> readout;
};

/// Both, each by the other: a rolling shutter bends pictures of what moves, and with them the camera (by percents of
/// the focal length), and a wrong camera's readout is wrong. Errors of calibrate_camera().
rt::Result<CameraAndReadout> calibrate_camera_and_readout(const Board& board, const std::vector<BoardView>& views,
                                                          int width, int height,
                                                          hal::CameraCalibration::Distortion model, double max_gap_s);

}  // namespace godwit::app
