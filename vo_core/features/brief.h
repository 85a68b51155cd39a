// Binary descriptors of small patches (Calonder et al. 2010, BRIEF): 256 comparisons of grey values around a corner.
#pragma once

#include <array>
#include <bit>
#include <cstdint>

#include "hal/rt/image.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

struct BriefDescriptor {
  std::array<std::uint64_t, 4> word{};

  /// Comparisons that differ, 0 to 256. Unrelated patches: about 128.
  int distance(const BriefDescriptor& other) const {
    int d = 0;
    for (std::size_t i = 0; i < word.size(); ++i) d += std::popcount(word[i] ^ other.word[i]);
    return d;
  }
};

/// The comparisons, turned about the patch's centre.
class BriefPattern {
 public:
  static constexpr int kLevel = 1;     ///< pyramid level on which patches are compared
  static constexpr int kReach = 16;    ///< a patch needs so many pixels of that level on every side
  static constexpr double kSigma = 6;  ///< of the compared places about the centre [px of that level]

  /// roll_rad: a patch that shows, turned by so much, what another shows upright gets that one's descriptor.
  explicit BriefPattern(double roll_rad);

  /// Descriptor of the patch around a level-0 pixel. False where the patch leaves the picture. No allocation.
  bool describe(const rt::PyramidView& pyramid, const Vec2f& px, BriefDescriptor* out) const;

 private:
  struct Pair {
    std::int8_t x0, y0, x1, y1;
  };
  std::array<Pair, 256> pairs_;
};

}  // namespace godwit::vo
