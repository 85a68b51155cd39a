// Which pictures the detector looks at: one policy for threads and for --sequential. Pure logic.
#pragma once

#include <optional>

#include "firmware_app/pipeline/detector_stage.h"
#include "firmware_app/scheduler/scheduler.h"
#include "hal/rt/frame_pool.h"

namespace godwit::app {

/// For a scheduler whose clock counts frames instead of time, and whose detections take none of it: the same pictures
/// are looked at in every run.
SchedulerOptions counting_frames(SchedulerOptions options);

/// A frame went through the tracker, and with it comes the detector's reference to its slot. Returns it, with its
/// reference, if the detector is to look at it now; the scheduler counts the order as under way. Otherwise the
/// reference goes back through `back`. No allocation, bounded.
///
/// Always the newest picture; a keyframe only makes it sooner, and one that comes while the detector is busy is not
/// looked at itself: its movers are known from the pictures before it (MaskExchange). Kept for it, two or one until
/// they were too old, keyframes made the masks of all other pictures older: walkers over 61 % of the picture, twelve
/// sequential flights of each with answers given 72 to 106 ms of the recording after their order: ATE 58, 29 and,
/// without any kept, 22 mm at the worst; 303, 204 and 160 poses off by more than 5 cm. (Flown with times of chance;
/// what is flown since, with answers 85 ms after their order: benchmarks/dynamic --worlds severe --guards both
/// --detection-ms 85.)
std::optional<DetectorJob> order_detection(const rt::FrameHandle& frame, bool keyframe, rt::TimeNs now_ns,
                                           Scheduler* scheduler, rt::FrameReturn* back);

}  // namespace godwit::app
