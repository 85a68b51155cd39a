// Which pictures the detector looks at: one policy for threads and for --sequential. Pure logic.
#pragma once

#include <optional>

#include "firmware_app/pipeline/detector_stage.h"
#include "firmware_app/pipeline/stage.h"
#include "firmware_app/scheduler/scheduler.h"
#include "hal/rt/frame_pool.h"
#include "hal/rt/spsc_ring.h"

namespace godwit::app {

/// For a scheduler whose clock counts frames instead of time, and whose detections take none of it: the same pictures
/// are looked at in every run.
SchedulerOptions counting_frames(SchedulerOptions options);

/// Keyframes first, oldest first, as long as their mask comes in time; else the newest picture when the scheduler says
/// so. One thread; no allocation, bounded.
class DetectionOrders {
 public:
  /// real_pace: the scheduler's clock and that of the capture times are the same; otherwise what a detection takes says
  /// nothing of the recording's time, and a keyframe waits mask_age_ns of that.
  DetectionOrders(bool real_pace, rt::TimeNs mask_age_ns) : real_pace_(real_pace), mask_age_ns_(mask_age_ns) {}

  /// A frame went through the tracker, and with it comes the detector's reference to its slot. Returns the picture that
  /// the detector is to look at now, with its reference; the scheduler counts the order as under way. References to
  /// pictures that nobody will look at go back through `back`.
  std::optional<DetectorJob> next(const rt::FrameHandle& frame, bool keyframe, rt::TimeNs now_ns, Scheduler* scheduler,
                                  rt::FrameReturn* back);

 private:
  void forget_oldest(Scheduler* scheduler, rt::FrameReturn* back);

  const bool real_pace_;
  const rt::TimeNs mask_age_ns_;
  /// Keyframes that wait for the detector, oldest first, each with its slot. One makes way when there are more, or when
  /// its mask would come too late. Only one thread uses it.
  rt::SpscRing<rt::FrameHandle, kDetectorSlots - 1> waiting_;
};

}  // namespace godwit::app
