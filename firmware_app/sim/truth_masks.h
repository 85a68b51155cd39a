// The true boxes of a simulated flight as masks: what a detector without fault would give, without delay.
#pragma once

#include <memory>
#include <span>

#include "detector/box_mask.h"
#include "firmware_app/pipeline/mask_source.h"
#include "hal/rt/spsc_ring.h"
#include "hal/sim/render/renderer.h"

namespace godwit::app {

/// From the camera's thread to the tracker's. Everything is allocated by the constructor.
class TruthMasks final : public MaskSource {
 public:
  /// Size of the picture.
  TruthMasks(int width, int height);

  /// Camera thread. The boxes of a picture that will reach the tracker or be dropped on the way: all people, cars and
  /// trucks, also those that stand, because a network knows kinds and not motions. Of more than detector::kMaxBoxes the
  /// first stay.
  void put(std::uint32_t sequence, std::span<const sim::TrueBox> boxes);
  /// Tracker thread. No mask for a picture whose boxes were not put.
  rt::MaskPyramidView mask_for(const rt::FrameMeta& frame, const rt::ImageView& /*grey*/) override;

 private:
  struct Entry {
    std::uint32_t sequence = 0;
    detector::BoxList boxes;
  };
  /// More than the pictures between camera and tracker (8 in the ring, one in work, one being read).
  static constexpr std::size_t kEntries = 32;

  std::unique_ptr<rt::SpscRing<Entry, kEntries>> ring_;
  Entry filling_;  ///< camera thread's own
  detector::BoxMask mask_;
};

}  // namespace godwit::app
