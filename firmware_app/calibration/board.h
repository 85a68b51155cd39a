// The flat boards that cameras are calibrated by, and where their points lie.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "hal/rt/image.h"
#include "hal/rt/result.h"
#include "hal/rt/time.h"

namespace godwit::app {

/// Board frame: x right, y up along the printed side, z towards the viewer; metres.
struct Board {
  enum class Kind : std::uint8_t {
    kChessboard,  ///< points: inner corners
    kAprilGrid    ///< Kalibr's: AprilTags 36h11 in a grid, numbered by rows from 0; points: their corners
  };
  Kind kind = Kind::kAprilGrid;
  int columns = 6, rows = 6;  ///< of inner corners, or of tags
  double size_m = 0.088;      ///< side of a square, or of a tag
  double spacing = 0.3;       ///< AprilGrid: gap between two tags over size_m

  int points() const { return columns * rows * (kind == Kind::kAprilGrid ? 4 : 1); }
  /// Of an AprilGrid: corner k of tag n is point 4 n + k, from its lower left against the clock.
  std::array<double, 3> point(int id) const;
};

/// "chessboard:COLUMNSxROWS:SQUARE" (inner corners) or "aprilgrid:COLUMNSxROWS:TAG:SPACING"; metres. Error: what is
/// allowed.
rt::Result<Board> parse_board(const std::string& text);

/// A point of the board in a picture [pixels], (0, 0) the centre of the top-left pixel.
struct BoardPoint {
  int id = 0;
  double x = 0, y = 0;
};

/// One picture of the board.
struct BoardView {
  rt::TimeNs t_ns = 0;  ///< of the source; 0: unknown
  std::string name;
  std::vector<BoardPoint> points;
};

/// Finds the board; in the order of the points' numbers. Tags need not all be seen, squares must be. Empty: it is not
/// there. Allocates.
std::vector<BoardPoint> find_board(const Board& board, const rt::ImageView& grey);

/// Mean distance of the points that both pictures show [pixels]; nothing: they share none. Points in the order of their
/// numbers.
std::optional<double> mean_distance(const BoardView& a, const BoardView& b);

}  // namespace godwit::app
