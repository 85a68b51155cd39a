// What one detection misses of what was there before: looked for once more among its unsure boxes, then held for a
// while.
#pragma once

#include <cstdint>
#include <span>

#include "detector/box.h"

namespace godwit::detector {

struct HoldLimits {
  int width = 0;             ///< of the picture [px]
  float sure_score = 0.25F;  ///< from here on a box stands for itself
  float overlap = 0.3F;      ///< intersection over union: an unsure box is the thing that was there
  float covered = 0.7F;      ///< of a box that was there, by one new box: it is found, or masked anyway
  int detections = 2;        ///< so many in a row may miss a thing
  /// And for no longer than this from the detection that last found it, as CarrierLimits::max_age_ns: where detections
  /// are rarer, fewer may miss it.
  std::int64_t longest_ns = 1'000'000'000;
};

/// Makes one list of a detection and what was there before it (the second association of Zhang et al., ByteTrack, 2022,
/// and a hold). `before`: the boxes of earlier detections as carried to the picture of this one. `found`: this
/// detection's boxes down to a threshold below `sure_score`; of those the unsure stay that overlap a box of their class
/// that was there and that no sure box has taken. Only what the picture cuts off at a side or at the top is helped so:
/// it is what drops out, a person without a head most of all, and for what is whole it would mask more that is nobody
/// than it finds. What was there and is not found stays as it was carried, until HoldLimits::detections in a row have
/// missed it (Box::missed); `apart_ns` is the time since the detection before. Sure boxes come first, then unsure ones,
/// then held ones: where the list is full, those that are left out are the last. Never makes a thing of an unsure box
/// alone. Pure, no allocation, at most kMaxBoxes^2 comparisons for each of its passes.
void hold(std::span<const Box> before, std::int64_t apart_ns, const HoldLimits& limits, BoxList* found);

}  // namespace godwit::detector
