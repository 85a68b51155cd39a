// A look at what the tracker saw of a frame.
#pragma once

#include <span>

#include "hal/rt/frame_pool.h"
#include "hal/rt/image.h"
#include "vo_core/map/map_exchange.h"

namespace godwit::app {

/// Called by the tracker's thread at the end of each frame. In flight under its rules: no allocation, no lock, no wait.
/// Only where nobody waits for poses (`--view`) may it take its time.
class FrameView {
 public:
  virtual ~FrameView() = default;
  /// `mask`: the frame's dynamic pixels, levels == 0 where there are none. `features`: the measurements behind its
  /// pose; empty without one. All valid during the call only.
  virtual void look(const rt::FrameMeta& frame, const rt::ImageView& grey, const rt::MaskPyramidView& mask,
                    std::span<const vo::FrameFeature> features) = 0;
  /// Whether what look() takes is time of the frame, as it is in flight. Not where pictures are made for people.
  virtual bool counts() const { return true; }
};

}  // namespace godwit::app
