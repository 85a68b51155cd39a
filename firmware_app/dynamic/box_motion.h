// How the picture inside a box moved from one frame to the next: block matching on a quarter-size picture.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "detector/box.h"
#include "detector/box_carrier.h"
#include "hal/rt/image.h"

namespace godwit::app {

/// Keeps the small pictures of two frames. The constructor allocates; nothing else does. One thread.
class BoxMotion {
 public:
  static constexpr int kShrink = 4;        ///< pixels of the picture to one of the small picture, each way
  static constexpr int kReach = 6;         ///< largest motion looked for [small pixels]
  static constexpr int kMaxBoxes = 16;     ///< more are not followed: they go with the camera
  static constexpr int kMaxPixels = 1200;  ///< of a box that are compared; larger boxes are thinned out

  BoxMotion(int width, int height);

  /// Takes the next picture and writes for each box (pixels of the picture before) how its inside moved, as a few
  /// feature motions of equal shift; none where it shows no motion, because it is grey in grey. Bounded: kMaxBoxes *
  /// kMaxPixels * (2 kReach + 1)^2 comparisons at most.
  std::span<const detector::FeatureMotion> next(const rt::ImageView& grey, std::span<const detector::Box> boxes);

 private:
  void shrink(const rt::ImageView& grey);
  bool follow(const detector::Box& box, float* dx, float* dy) const;

  int width_, height_;  ///< of the small picture
  std::vector<std::uint8_t> before_, now_;
  std::vector<std::uint16_t> columns_;  ///< sums of one row of the small picture
  bool have_before_ = false;
  std::vector<detector::FeatureMotion> motions_;
};

}  // namespace godwit::app
