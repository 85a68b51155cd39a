#include "vo_core/features/candidate_grid.h"

#include <algorithm>
#include <cassert>

#include "hal/rt/count.h"
#include "vo_core/features/shi_tomasi.h"

namespace godwit::vo {

CandidateGrid::CandidateGrid(int width, int height, int levels)
    : columns_((width + kCellPx - 1) / kCellPx), rows_((height + kCellPx - 1) / kCellPx), levels_(levels) {
  const std::size_t cells = columns_ * rows_;
  slots_.resize(cells * levels);
  candidates_.reserve(capacity());
  cell_begin_.resize(cells + 1);
  clear();
}

void CandidateGrid::clear() {
  for (Slot& slot : slots_) slot.count = 0;
  candidates_.clear();
  std::fill(cell_begin_.begin(), cell_begin_.end(), 0);
}

void CandidateGrid::add_corner(int x, int y, int level, int fast_score) {
  // The cell of the level-0 pixel (x + 0.5) * 2^level - 0.5, in integers.
  const int half = (1 << level) >> 1;
  const int column = ((x << level) + half) / kCellPx, row = ((y << level) + half) / kCellPx;
  assert(column < columns_ && row < rows_ && level < levels_);
  Slot& slot = slots_[cell_index(column, row) * levels_ + level];
  const Corner corner{static_cast<std::int16_t>(x), static_cast<std::int16_t>(y),
                      static_cast<std::uint8_t>(fast_score)};
  // Strongest first; of equal ones the earlier stays.
  int position = slot.count;
  while (position > 0 && slot.corner[position - 1].fast < corner.fast) --position;
  if (position == kPerCell) return;
  if (slot.count < kPerCell) ++slot.count;
  for (int i = slot.count - 1; i > position; --i) {
    slot.corner[i] = slot.corner[i - 1];
  }
  slot.corner[position] = corner;
}

void CandidateGrid::score_corners(const rt::PyramidView& pyramid, int fast_threshold, std::span<const float> min_score,
                                  float level_weight) {
  candidates_.clear();
  const std::size_t levels = levels_, cells = cell_begin_.size() - 1;
  for (std::size_t cell = 0; cell < cells; ++cell) {
    cell_begin_[cell] = rt::count_of(candidates_);
    const std::span<const Slot> slots(&slots_[cell * levels], levels);
    int strongest = 0;
    for (const Slot& slot : slots) {
      if (slot.count > 0) strongest = std::max<int>(strongest, slot.corner[0].fast);
    }
    float weight = 1.0f;
    for (int level = 0; level < levels_; ++level, weight *= level_weight) {
      for (int i = 0; i < slots[level].count; ++i) {
        const Corner& corner = slots[level].corner[i];
        const bool weak = strongest > fast_threshold && corner.fast <= fast_threshold;
        const float score = shi_tomasi(pyramid.level[level], corner.x, corner.y);
        if (score < min_score[level]) continue;
        candidates_.push_back({from_level(corner.x, corner.y, level), score, weight * score, corner.x, corner.y,
                               static_cast<std::int8_t>(level), weak, true});
      }
    }
  }
  cell_begin_[cells] = rt::count_of(candidates_);
}

template <typename F>
void CandidateGrid::while_near(const Vec2f& px, float radius, F&& f) {
  const auto cell = [](float v, int count) {
    return std::clamp(static_cast<int>(v / static_cast<float>(kCellPx)), 0, count - 1);
  };
  const int c0 = cell(px.x() - radius, columns_), c1 = cell(px.x() + radius, columns_);
  const int r0 = cell(px.y() - radius, rows_), r1 = cell(px.y() + radius, rows_);
  for (int row = r0; row <= r1; ++row) {
    // The cells of a row lie one behind the other.
    const int end = cell_begin_[cell_index(c1, row) + 1];
    for (int i = cell_begin_[cell_index(c0, row)]; i < end; ++i) {
      if (!f(candidates_[i])) return;
    }
  }
}

void CandidateGrid::keep_local_best() {
  // Of equal ranks the one that comes first stays.
  const auto beats = [](const Candidate& a, const Candidate& b) {
    if (a.weak != b.weak) return b.weak;
    return a.rank > b.rank || (a.rank == b.rank && &a < &b);
  };
  // Each pair is looked at from the coarser one, whose spacing counts: most are fine, and have few so near.
  for (Candidate& mine : candidates_) {
    const float spacing = min_spacing_px(mine.level, mine.level);
    // A coarser level's pixel lies in the cell of its middle, half a level-0 pixel further on.
    while_near(mine.px, spacing + 0.5f, [&](Candidate& other) {
      if ((mine.px - other.px).squaredNorm() > spacing * spacing || other.level > mine.level || &other == &mine)
        return true;
      (beats(other, mine) ? mine : other).alive = false;
      return true;
    });
  }
}

void CandidateGrid::remove_near(const Vec2f& px, int level) {
  const float reach = min_spacing_px(std::max(level, levels_ - 1), levels_ - 1);
  while_near(px, reach, [&](Candidate& other) {
    const float spacing = min_spacing_px(level, other.level);
    if ((px - other.px).squaredNorm() <= spacing * spacing) other.alive = false;
    return true;
  });
}

bool CandidateGrid::cell_has_candidate(int column, int row) const {
  const std::size_t cell = cell_index(column, row);
  for (int i = cell_begin_[cell]; i < cell_begin_[cell + 1]; ++i) {
    if (candidates_[i].alive) return true;
  }
  return false;
}

}  // namespace godwit::vo
