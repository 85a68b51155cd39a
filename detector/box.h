// A found object: a box in the picture, what it is, how sure.
#pragma once

#include <array>
#include <span>

namespace godwit::detector {

/// Most boxes that leave the detector for one picture; the surest stay.
constexpr int kMaxBoxes = 128;

/// Edges in picture pixels, where pixel (i, j) covers [i, i + 1) x [j, j + 1). Finite, inside the picture, x0 < x1, y0
/// < y1.
struct Box {
  float x0 = 0.F, y0 = 0.F, x1 = 0.F, y1 = 0.F;
  float score = 0.F;  ///< 0..1
  int class_id = 0;   ///< index into ModelInfo::classes
  int track = -1;     ///< names the same thing from detection to detection; -1: not followed
  int missed = 0;     ///< detections in a row that have missed it (box_hold.h)

  float width() const { return x1 - x0; }
  float height() const { return y1 - y0; }
};

/// Up to kMaxBoxes boxes in place, so that a list crosses threads without an allocation.
struct BoxList {
  std::array<Box, kMaxBoxes> box{};
  int count = 0;

  std::span<const Box> view() const { return std::span(box).first(count); }
  std::span<Box> view() { return std::span(box).first(count); }
  void clear() { count = 0; }
  /// Returns false when full; the box is then dropped.
  bool push(const Box& b) {
    if (count == kMaxBoxes) return false;
    box[count++] = b;
    return true;
  }
};

}  // namespace godwit::detector
