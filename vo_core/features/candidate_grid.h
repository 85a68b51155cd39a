// The corners among which the quadtree chooses: the strongest few of each small cell, on all levels, each physical
// corner once.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "hal/rt/image.h"
#include "vo_core/geometry/geometry.h"
#include "vo_core/image/levels.h"

namespace godwit::vo {

/// A feature that may be taken.
struct Candidate {
  Vec2f px;           // level-0 pixels
  float score;        // Shi-Tomasi
  float rank;         // what counts where candidates compete: the score, less on coarser levels
  std::int16_t x, y;  // pixels of its level
  std::int8_t level;
  bool weak;   // below the first FAST threshold although its cell has corners above it
  bool alive;  // not yet ruled out
};

/// Distance [level-0 px] below which two features, found on these levels, are held to be one.
inline float min_spacing_px(int level_a, int level_b) {
  const int coarser = level_a > level_b ? level_a : level_b;
  const float spacing = 1.5f * level_scale(coarser);
  return spacing > 4.0f ? spacing : 4.0f;
}

/// Cells of kCellPx x kCellPx level-0 pixels. Only the constructor allocates. One thread at a time.
class CandidateGrid {
 public:
  static constexpr int kCellPx = 16;
  /// Corners kept of each cell on each level, by FAST score.
  static constexpr int kPerCell = 3;

  CandidateGrid(int width, int height, int levels);

  int columns() const { return columns_; }
  int rows() const { return rows_; }
  /// Most candidates that can stand.
  int capacity() const { return columns_ * rows_ * levels_ * kPerCell; }

  /// Forgets everything.
  void clear();
  /// A FAST corner at pixel (x, y) of a level. Kept if it is among the strongest of its cell and level.
  void add_corner(int x, int y, int level, int fast_score);
  /// Turns the corners into candidates with Shi-Tomasi score, and rank = score * level_weight^level. In a cell that has
  /// corners above fast_threshold the others are marked weak; in a cell without, they are all there is: that lowers the
  /// threshold where texture is weak. Candidates below their level's min_score are dropped.
  void score_corners(const rt::PyramidView& pyramid, int fast_threshold, std::span<const float> min_score,
                     float level_weight);
  /// Rules out every candidate that has one of higher rank, of any level, within min_spacing_px. A weak
  /// one never rules out another that is not.
  void keep_local_best();
  /// Rules out the candidates within min_spacing_px of a feature that exists.
  void remove_near(const Vec2f& px, int level);

  std::span<const Candidate> candidates() const { return candidates_; }
  /// The cell holds a candidate that is alive.
  bool cell_has_candidate(int column, int row) const;

 private:
  struct Corner {
    std::int16_t x, y;
    std::uint8_t fast;
  };
  struct Slot {
    std::array<Corner, kPerCell> corner;
    std::int8_t count;
  };
  std::size_t cell_index(int column, int row) const { return row * columns_ + column; }
  /// Calls f(candidate) for those in the cells that a square of +-radius around px touches, until it returns false.
  template <typename F>
  void while_near(const Vec2f& px, float radius, F&& f);

  int columns_, rows_, levels_;
  std::vector<Slot> slots_;               // [cell][level]
  std::vector<Candidate> candidates_;     // by cell
  std::vector<std::int32_t> cell_begin_;  // [cells + 1] into candidates_
};

}  // namespace godwit::vo
