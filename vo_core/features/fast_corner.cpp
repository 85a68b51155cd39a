#include "vo_core/features/fast_corner.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cassert>
#include <cstring>
#include <hwy/highway.h>

namespace godwit::vo {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

using Bytes = hn::ScalableTag<std::uint8_t>;
using ByteVec = hn::Vec<Bytes>;

/// The circle, clockwise from the top: every arc is a run of indices modulo 16.
constexpr std::array<std::array<int, 2>, 16> kCircle{{{0, -3},
                                                      {1, -3},
                                                      {2, -2},
                                                      {3, -1},
                                                      {3, 0},
                                                      {3, 1},
                                                      {2, 2},
                                                      {1, 3},
                                                      {0, 3},
                                                      {-1, 3},
                                                      {-2, 2},
                                                      {-3, 1},
                                                      {-3, 0},
                                                      {-3, -1},
                                                      {-2, -2},
                                                      {-1, -3}}};

/// max over the 16 arcs of the min over the nine differences of the arc. d[i]: difference of circle pixel i, or 0.
inline ByteVec best_arc(const std::array<ByteVec, 16>& d) {
  // The arcs that start at i - 1 and at i share the eight pixels i .. i + 7, so only even i need a tree of minima.
  std::array<ByteVec, 8> pair, four;
  for (std::size_t i = 0; i < 8; ++i) pair[i] = hn::Min(d[2 * i], d[2 * i + 1]);
  for (std::size_t i = 0; i < 8; ++i) four[i] = hn::Min(pair[i], pair[(i + 1) % 8]);
  ByteVec best = hn::Zero(Bytes());
  for (std::size_t i = 0; i < 8; ++i) {
    const ByteVec eight = hn::Min(four[i], four[(i + 2) % 8]);
    const ByteVec ninth = hn::Max(d[(2 * i + 8) % 16], d[(2 * i + 15) % 16]);
    best = hn::Max(best, hn::Min(eight, ninth));
  }
  return best;
}

}  // namespace

int fast_score(const rt::ImageView& image, int x, int y) {
  const int centre = image.at(x, y);
  int best = 0;
  for (std::size_t start = 0; start < 16; ++start) {
    int brighter = 255, darker = 255;
    for (std::size_t i = 0; i < 9; ++i) {
      const auto& [dx, dy] = kCircle[(start + i) % 16];
      const int difference = image.at(x + dx, y + dy) - centre;
      brighter = std::min(brighter, difference);
      darker = std::min(darker, -difference);
    }
    best = std::max({best, brighter, darker});
  }
  return best;
}

void fast_score_row(const rt::ImageView& image, int y, int x_begin, int x_end, int threshold, std::uint8_t* scores) {
  assert(x_begin >= kFastRadius && x_end <= image.width - kFastRadius);
  assert(y >= kFastRadius && y < image.height - kFastRadius);
  assert(threshold >= 0 && threshold < 255);
  const Bytes d8;
  const int lanes = static_cast<int>(hn::Lanes(d8));
  const std::uint8_t* row = image.row(y);
  if (x_end - x_begin < lanes) {
    for (int x = x_begin; x < x_end; ++x) {
      const int score = fast_score(image, x, y);
      scores[x] = static_cast<std::uint8_t>(score > threshold ? score : 0);
    }
    return;
  }

  std::array<std::ptrdiff_t, 16> offset;
  for (std::size_t i = 0; i < 16; ++i)
    offset[i] = kCircle[i][1] * static_cast<std::ptrdiff_t>(image.stride) + kCircle[i][0];
  const ByteVec limit = hn::Set(d8, static_cast<std::uint8_t>(threshold));

  for (int x = x_begin;;) {
    const std::uint8_t* p = row + x;
    const ByteVec centre = hn::LoadU(d8, p);
    // Every arc of nine holds two neighbouring points of the four of a cross, so its score is at most
    // max(min(0, 4), min(4, 8), min(8, 12), min(12, 0)) = min(max(0, 8), max(4, 12)) of their differences.
    const auto cross_bound = [&](std::size_t first) {
      const ByteVec a = hn::LoadU(d8, p + offset[first]), b = hn::LoadU(d8, p + offset[first + 4]);
      const ByteVec c = hn::LoadU(d8, p + offset[first + 8]), d = hn::LoadU(d8, p + offset[first + 12]);
      const ByteVec high = hn::Min(hn::Max(a, c), hn::Max(b, d));
      const ByteVec low = hn::Max(hn::Min(a, c), hn::Min(b, d));
      return hn::Max(hn::SaturatedSub(high, centre), hn::SaturatedSub(centre, low));
    };
    const ByteVec bound = hn::Min(cross_bound(0), cross_bound(2));
    ByteVec score = hn::Zero(d8);
    if (!hn::AllTrue(d8, hn::Eq(hn::SaturatedSub(bound, limit), score))) {
      std::array<ByteVec, 16> brighter, darker;
      for (std::size_t i = 0; i < 16; ++i) {
        const ByteVec v = hn::LoadU(d8, p + offset[i]);
        brighter[i] = hn::SaturatedSub(v, centre);
        darker[i] = hn::SaturatedSub(centre, v);
      }
      score = hn::Max(best_arc(brighter), best_arc(darker));
      score = hn::IfThenZeroElse(hn::Eq(hn::SaturatedSub(score, limit), hn::Zero(d8)), score);
    }
    hn::StoreU(score, d8, scores + x);
    if (x + lanes == x_end) break;
    // The last vector overlaps the one before it rather than reaching over the end.
    x = x + 2 * lanes <= x_end ? x + lanes : x_end - lanes;
  }
}

int fast_maxima_row(const std::uint8_t* above, const std::uint8_t* row, const std::uint8_t* below, int x_begin,
                    int x_end, std::int16_t* xs) {
  const Bytes d8;
  const int lanes = static_cast<int>(hn::Lanes(d8));
  int count = 0;
  int x = x_begin;
  for (; x + lanes <= x_end; x += lanes) {
    const ByteVec centre = hn::LoadU(d8, row + x);
    const ByteVec zero = hn::Zero(d8);
    if (hn::AllTrue(d8, hn::Eq(centre, zero))) continue;
    const auto around = [&](const std::uint8_t* r) {
      return hn::Max(hn::Max(hn::LoadU(d8, r + x - 1), hn::LoadU(d8, r + x)), hn::LoadU(d8, r + x + 1));
    };
    const ByteVec before = hn::Max(around(above), hn::LoadU(d8, row + x - 1));
    const ByteVec after = hn::Max(around(below), hn::LoadU(d8, row + x + 1));
    // centre > before and centre >= after; zero is never a maximum because before >= 0.
    const auto loses =
        hn::Or(hn::Eq(hn::SaturatedSub(centre, before), zero), hn::Ne(hn::SaturatedSub(after, centre), zero));
    std::array<std::uint8_t, 64> bits{};
    const std::size_t bytes = hn::StoreMaskBits(d8, hn::Not(loses), bits.data());
    for (std::size_t word = 0; word * 8 < bytes; ++word) {
      std::uint64_t set;
      std::memcpy(&set, bits.data() + word * 8, sizeof set);
      for (; set != 0; set &= set - 1) {
        xs[count++] = static_cast<std::int16_t>(x + static_cast<int>(word) * 64 + std::countr_zero(set));
      }
    }
  }
  for (; x < x_end; ++x) {
    const int centre = row[x];
    const int before = std::max({above[x - 1], above[x], above[x + 1], row[x - 1]});
    const int after = std::max({below[x - 1], below[x], below[x + 1], row[x + 1]});
    if (centre > before && centre >= after) xs[count++] = static_cast<std::int16_t>(x);
  }
  return count;
}

}  // namespace godwit::vo
