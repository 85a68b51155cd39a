// Boxes of movable things become dynamic pixels at every pyramid level (the paper, section 2.3.1).
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "detector/box.h"
#include "hal/rt/image.h"

namespace godwit::detector {

struct MaskMargin {
  float share = 0.05F;       ///< of the box's side, on each side: boxes cut off hands and wing mirrors
  float pixels = 2.F;        ///< of level 0, on each side
  float level_pixels = 1.F;  ///< of each level itself: half-sampling smears the edge of a mover into its neighbour
};

/// The mask's storage at all levels, sized at construction. Not for two threads at once; update() does not allocate.
class BoxMask {
 public:
  static constexpr std::uint8_t kDynamic = 255;

  /// Precondition: 1 <= levels <= rt::kPyramidLevels; sizes are those of level 0, at most rt::kMaxImageWidth x
  /// kMaxImageHeight.
  BoxMask(int width, int height, int levels, const MaskMargin& margin = {});

  /// Masks the boxes whose class may move (`movable[class_id]`), nothing else. A class number outside `movable` counts
  /// as movable: what is unknown is not trusted. Boxes that are not finite are skipped; the rest is clipped to the
  /// picture.
  void update(std::span<const Box> boxes, const std::vector<bool>& movable);

  /// Valid until the next update().
  const rt::MaskPyramidView& view() const { return view_; }

 private:
  void mask_box(const Box& box);

  MaskMargin margin_;
  std::vector<std::uint8_t> storage_;
  std::array<rt::MutableImageView, rt::kPyramidLevels> level_{};
  rt::MaskPyramidView view_;
};

}  // namespace godwit::detector
