// What the odometry and the source of its masks tell each other around a frame. Tracker thread.
#pragma once

#include <array>
#include <limits>

#include "firmware_app/pipeline/mask_source.h"
#include "vo_core/tracking/tracker.h"

namespace godwit::app {

/// Keyframes whose mask comes late, and what a frame that was tracked says of the boxes in it. No allocation, no lock,
/// bounded. Source and tracker outlive it.
class MaskExchange {
 public:
  MaskExchange(MaskSource* source, vo::Tracker* tracker) : source_(source), tracker_(tracker) {}

  /// After mask_for() of the frame captured at now_ns, before it is tracked: one keyframe of which more is known by now
  /// than when it was masked is purged (vo::Tracker::late_mask): by detections of earlier pictures, at last by its own.
  /// One a frame: a bound on the cost.
  void purge_movers(rt::TimeNs now_ns);

  /// The frame captured at t_capture_ns went through the tracker with this result.
  void frame_done(rt::TimeNs t_capture_ns, const vo::FrameResult& result);

 private:
  /// No mask comes later than this.
  static constexpr rt::TimeNs kLateMaskNs = rt::kNsPerSecond;
  static constexpr rt::TimeNs kNoTime = std::numeric_limits<rt::TimeNs>::min();

  /// A keyframe that its own detection has not come for.
  struct WaitingKeyframe {
    rt::TimeNs t_ns = kNoTime;        ///< capture time; kNoTime: this place is free
    rt::TimeNs t_known_ns = kNoTime;  ///< of the picture whose detection it was last purged by
  };

  void note_keyframe(rt::TimeNs t_capture_ns);
  void tell(rt::TimeNs t_capture_ns, const vo::FrameResult& result);

  MaskSource* const source_;
  vo::Tracker* const tracker_;
  std::array<WaitingKeyframe, 16> waiting_;
  std::size_t next_waiting_ = 0;
  std::array<SeenPoint, vo::kMaxFrameFeatures> seen_points_;
};

}  // namespace godwit::app
