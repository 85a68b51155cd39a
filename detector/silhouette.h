// A box holds much that its object does not cover. The network's second output says what it does: boxes get the shape
// of that. Pure computation.
#pragma once

#include <span>

#include "detector/box.h"
#include "detector/decode.h"
#include "detector/model_info.h"

namespace godwit::detector {

/// Probability that something with a silhouette covers each cell of the network's input, row by row.
struct SilhouetteMap {
  std::span<const float> value;  ///< rows x columns
  int columns = 0, rows = 0;
};

struct SilhouetteOptions {
  float threshold = 0.3F;  ///< a cell at least this probable is covered: a missed limb costs more than a masked table
  /// A silhouette that fills less of its box is not believed: the whole box stays masked.
  float least_share = 0.15F;
};

/// Gives a shape to each box whose class has silhouettes (ModelInfo::silhouette), with holes filled; the others keep
/// theirs. NaN counts as covered. A map whose size is not its span's changes nothing. Does not allocate.
void shape_boxes(const SilhouetteMap& map, const ModelInfo& info, const LetterboxFit& fit,
                 const SilhouetteOptions& options, std::span<Box> boxes);

/// What a shape says of the picture outside its box.
enum class Outside { kFree, kCovered };

/// The shape of `box` over `other`: a cell is covered where any covered cell of `box` lies less than `reach_x`,
/// `reach_y` pixels away, and outside `box` as `outside` says. The edges of a box whose shape is not whole must not
/// change but by this. Does not allocate.
BoxShape shape_over(const Box& box, const Box& other, float reach_x, float reach_y, Outside outside);

}  // namespace godwit::detector
