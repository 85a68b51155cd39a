// Where the dynamic pixels of a frame come from: the detector, or in a simulation the truth.
#pragma once

#include <cstdint>
#include <span>

#include "hal/rt/frame_pool.h"
#include "hal/rt/image.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::app {

/// A map point where a frame showed it.
struct SeenPoint {
  float x = 0.F, y = 0.F;  ///< pixels, (0, 0) the centre of the top-left one
  float distance = 0.F;    ///< from the camera [map units]
};

/// What the odometry made of a frame. `points` is valid during the call only.
struct TrackedFrame {
  rt::TimeNs t_capture_ns = 0;
  std::uint32_t map_id = 0;
  vo::SE3 T_cam_world;
  std::span<const SeenPoint> points;  ///< what its pose stands on, outside the mask
};

/// Asked once for each frame, just before it is tracked.
class MaskSource {
 public:
  virtual ~MaskSource() = default;
  /// Tracker thread. `grey` is the frame's picture. The pixels of this frame that may move, at all levels of the
  /// pyramid (the paper, section 2.3.1); levels == 0: nothing is known. Valid until the next call. No allocation, no
  /// lock, never waits, bounded.
  virtual rt::MaskPyramidView mask_for(const rt::FrameMeta& frame, const rt::ImageView& grey) = 0;
  /// Tracker thread, after mask_for() of a newer frame. What is known by now of the picture captured at t_capture_ns,
  /// if that is more than when it was masked: a detection has come that was made on it or on an earlier one. Returns
  /// when the detection's picture was captured; known_ns, and no mask, if none has come that is newer than that one.
  /// Valid until the next call. The same rules.
  virtual rt::TimeNs late_mask(rt::TimeNs /*t_capture_ns*/, rt::TimeNs known_ns, rt::MaskPyramidView* /*mask*/) {
    return known_ns;
  }
  /// Tracker thread. Capture time of the picture whose detection came in with the last mask_for(); 0: none did.
  virtual rt::TimeNs t_detection_ns() const { return 0; }
  /// Tracker thread, after each frame that was tracked. No allocation, no lock, never waits, bounded.
  virtual void frame_tracked(const TrackedFrame& /*frame*/) {}
};

}  // namespace godwit::app
