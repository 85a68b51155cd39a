#include "vo_core/features/feature_detector.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>

#include "hal/rt/count.h"
#include "vo_core/features/candidate_grid.h"
#include "vo_core/features/edgelet.h"
#include "vo_core/features/fast_corner.h"
#include "vo_core/features/quadtree.h"
#include "vo_core/features/shi_tomasi.h"

namespace godwit::vo {
namespace {

/// Features that may exist already: twice what a keyframe can hold.
constexpr int kMaxOccupied = 4096;
/// An edge flatter than this [grey levels a pixel] is noise.
constexpr float kMinEdgeMagnitude = 6.0f;

/// The mask's view of a level; empty where nothing is masked.
const rt::ImageView& mask_level(const rt::MaskPyramidView& mask, int level) {
  static constexpr rt::ImageView kNothingMasked{};
  return level < mask.levels ? mask.level[level] : kNothingMasked;
}

/// Masked at its own level or where it lies in the full picture.
bool is_masked(const rt::MaskPyramidView& mask, int x, int y, int level) {
  if (mask.levels == 0) return false;
  if (mask_level(mask, level).at(x, y) != 0) return true;
  const int half = (1 << level) >> 1;
  return mask.level[0].at((x << level) + half, (y << level) + half) != 0;
}

}  // namespace

struct FeatureDetector::Buffers {
  Buffers(int w, int h, int levels)
      : width(w),
        height(h),
        grid(w, h, levels),
        tree(w, h, grid.capacity() + kMaxOccupied),
        row_scores(3 * (w + 1)),
        maxima(w),
        ids(grid.capacity()) {
    edgelets.reserve(grid.columns() * grid.rows());
    edgelet_levels.reserve(edgelets.capacity());
    cell_taken.resize(edgelets.capacity());
    edgelet_of_cell.resize(edgelets.capacity());
  }

  /// FAST corners of one level into the grid.
  void find_corners(const rt::ImageView& image, const rt::MaskPyramidView& mask, int level, int border, int threshold);
  /// The strongest edge of every cell that holds neither a candidate corner nor a feature, into edgelets.
  void find_edgelets(const rt::PyramidView& pyramid, const rt::MaskPyramidView& mask, int levels, int border);
  /// Marks the cells that an edgelet too close to a feature could lie in. px must be in the picture.
  void mark_cells(const Vec2f& px);
  /// An edgelet of the four neighbouring cells that come before this one is too close.
  bool near_last_edgelets(const Vec2f& px, int column, int row) const;
  std::size_t cell_index(int column, int row) const { return row * grid.columns() + column; }

  int width, height;
  CandidateGrid grid;
  Quadtree tree;
  std::vector<std::uint8_t> row_scores;  // three rows, rolling
  std::vector<std::int16_t> maxima;
  std::vector<std::int32_t> ids;
  std::vector<Edgelet> edgelets;
  std::vector<std::int8_t> edgelet_levels;
  std::vector<std::uint8_t> cell_taken;
  std::vector<std::int32_t> edgelet_of_cell;  // -1: none
};

void FeatureDetector::Buffers::find_corners(const rt::ImageView& image, const rt::MaskPyramidView& mask, int level,
                                            int border, int threshold) {
  const int x_begin = border, x_end = image.width - border;
  const int y_begin = border, y_end = image.height - border;
  if (x_begin >= x_end || y_begin >= y_end) return;
  // Zeros stand for the pixels beyond the border, left, right, above and below.
  std::fill(row_scores.begin(), row_scores.end(), std::uint8_t{0});
  const std::size_t length = row_scores.size() / 3;
  std::uint8_t* above = row_scores.data();
  std::uint8_t* row = above + length;
  std::uint8_t* below = row + length;
  fast_score_row(image, y_begin, x_begin, x_end, threshold, row);
  for (int y = y_begin; y < y_end; ++y) {
    if (y + 1 < y_end) {
      fast_score_row(image, y + 1, x_begin, x_end, threshold, below);
    } else {
      std::fill(below, below + length, std::uint8_t{0});
    }
    const int count = fast_maxima_row(above, row, below, x_begin, x_end, maxima.data());
    for (int i = 0; i < count; ++i) {
      const int x = maxima[i];
      if (!is_masked(mask, x, y, level)) grid.add_corner(x, y, level, row[x]);
    }
    std::uint8_t* const oldest = above;
    above = row;
    row = below;
    below = oldest;
  }
}

void FeatureDetector::Buffers::mark_cells(const Vec2f& px) {
  const float reach = min_spacing_px(0, 0);
  const auto cell = [](float v, int count) {
    return std::clamp(static_cast<int>(v / static_cast<float>(CandidateGrid::kCellPx)), 0, count - 1);
  };
  const int c1 = cell(px.x() + reach, grid.columns()), r1 = cell(px.y() + reach, grid.rows());
  for (int row = cell(px.y() - reach, grid.rows()); row <= r1; ++row) {
    for (int column = cell(px.x() - reach, grid.columns()); column <= c1; ++column) {
      cell_taken[cell_index(column, row)] = 1;
    }
  }
}

bool FeatureDetector::Buffers::near_last_edgelets(const Vec2f& px, int column, int row) const {
  constexpr std::array<std::array<int, 2>, 4> kBefore{{{-1, 0}, {-1, -1}, {0, -1}, {1, -1}}};
  for (const auto& [dx, dy] : kBefore) {
    if (column + dx < 0 || column + dx >= grid.columns() || row + dy < 0) continue;
    const std::int32_t other = edgelet_of_cell[cell_index(column + dx, row + dy)];
    if (other < 0) continue;
    const Edgelet& e = edgelets[other];
    const float spacing = min_spacing_px(0, 0);
    if ((from_level(e.x, e.y, edgelet_levels[other]) - px).norm() < spacing) return true;
  }
  return false;
}

void FeatureDetector::Buffers::find_edgelets(const rt::PyramidView& pyramid, const rt::MaskPyramidView& mask,
                                             int levels, int border) {
  edgelets.clear();
  edgelet_levels.clear();
  std::fill(edgelet_of_cell.begin(), edgelet_of_cell.end(), -1);
  for (int row = 0; row < grid.rows(); ++row) {
    for (int column = 0; column < grid.columns(); ++column) {
      if (cell_taken[cell_index(column, row)] != 0 || grid.cell_has_candidate(column, row)) {
        continue;
      }
      Edgelet best;
      int best_level = -1;
      for (int level = 0; level < levels; ++level) {
        const rt::ImageView& image = pyramid.level[level];
        const int cell = CandidateGrid::kCellPx >> level;
        const int x0 = std::max(column * cell, border), x1 = std::min((column + 1) * cell, image.width - border);
        const int y0 = std::max(row * cell, border), y1 = std::min((row + 1) * cell, image.height - border);
        Edgelet found;
        if (x0 >= x1 || y0 >= y1) continue;
        if (!find_edgelet(image, mask_level(mask, level), x0, y0, x1, y1, kMinEdgeMagnitude, &found)) continue;
        if (found.magnitude <= best.magnitude || is_masked(mask, found.x, found.y, level)) continue;
        best = found;
        best_level = level;
      }
      if (best_level < 0 || near_last_edgelets(from_level(best.x, best.y, best_level), column, row)) continue;
      edgelet_of_cell[cell_index(column, row)] = rt::count_of(edgelets);
      edgelets.push_back(best);
      edgelet_levels.push_back(static_cast<std::int8_t>(best_level));
    }
  }
}

FeatureDetector::FeatureDetector(int width, int height, const FeatureDetectorOptions& options)
    : options_(options), buffers_(new Buffers(width, height, options.levels)) {
  assert(options.levels >= 1 && options.levels <= rt::kPyramidLevels);
  assert(options.fast_threshold >= 1 && options.fast_threshold < 255);
}

FeatureDetector::~FeatureDetector() {
  delete buffers_;
}

int FeatureDetector::detect(const rt::PyramidView& pyramid, const rt::MaskPyramidView& mask,
                            std::span<const Vec2f> occupied, int wanted, std::span<Feature> out) {
  Buffers& b = *buffers_;
  assert(pyramid.level[0].width == b.width && pyramid.level[0].height == b.height);
  assert(wanted >= 0 && std::ssize(out) >= wanted);
  assert(occupied.size() <= kMaxOccupied);
  // A level that the mask does not cover is not searched: what moves there is unknown.
  int levels = std::min(options_.levels, pyramid.levels);
  if (mask.levels > 0) levels = std::min(levels, mask.levels);
  const int border = std::max(options_.border_px, kShiTomasiBorder);
  wanted = std::min(wanted, rt::count_of(b.ids));

  noise_ = grey_noise(pyramid.level[0]);
  b.grid.clear();
  std::array<float, rt::kPyramidLevels> min_score;
  for (int level = 0; level < levels; ++level) {
    const float sigma = grey_noise_at(noise_, level);
    const int lowest =
        std::clamp(static_cast<int>(std::lround(options_.fast_sigmas * sigma)), 1, options_.fast_threshold);
    min_score[level] = options_.min_score * sigma * sigma;
    b.find_corners(pyramid.level[level], mask, level, border, lowest);
  }
  b.grid.score_corners(pyramid, options_.fast_threshold, min_score, options_.level_weight);
  b.grid.keep_local_best();
  b.tree.clear();
  for (const Vec2f& px : occupied) {
    if (b.tree.add_occupied(px.x(), px.y())) b.grid.remove_near(px, 0);
  }
  const std::span<const Candidate> candidates = b.grid.candidates();
  // Weak corners only if the others do not suffice.
  int taken = 0;
  for (const bool weak : {false, true}) {
    for (std::size_t i = 0; i < candidates.size(); ++i) {
      const Candidate& c = candidates[i];
      if (!c.alive || c.weak != weak) continue;
      b.tree.add_candidate(c.px.x(), c.px.y(), c.rank, static_cast<std::int32_t>(i));
    }
    taken = b.tree.select(wanted, b.ids);
    if (taken == wanted) break;
  }
  for (int i = 0; i < taken; ++i) {
    const Candidate& c = candidates[b.ids[i]];
    out[i] = {c.px, Vec2f::UnitX(), c.score, c.level, FeatureType::kCorner};
  }
  if (taken == wanted || !options_.edgelets) return taken;

  // What corners left open is filled with edgelets, spread by the same tree around the corners just taken.
  std::fill(b.cell_taken.begin(), b.cell_taken.end(), std::uint8_t{0});
  b.tree.clear();
  const auto serve = [&](const Vec2f& px) {
    if (b.tree.add_occupied(px.x(), px.y())) b.mark_cells(px);
  };
  for (const Vec2f& px : occupied) serve(px);
  for (int i = 0; i < taken; ++i) serve(out[i].px);
  b.find_edgelets(pyramid, mask, levels, border);
  for (std::size_t i = 0; i < b.edgelets.size(); ++i) {
    const Edgelet& e = b.edgelets[i];
    const Vec2f px = from_level(e.x, e.y, b.edgelet_levels[i]);
    b.tree.add_candidate(px.x(), px.y(), e.magnitude, static_cast<std::int32_t>(i));
  }
  const int added = b.tree.select(wanted - taken, b.ids);
  for (int i = 0; i < added; ++i) {
    const std::size_t id = b.ids[i];
    const Edgelet& e = b.edgelets[id];
    const std::int8_t level = b.edgelet_levels[id];
    out[taken + i] = {from_level(e.x, e.y, level), e.direction, e.magnitude, level, FeatureType::kEdgelet};
  }
  return taken + added;
}

}  // namespace godwit::vo
