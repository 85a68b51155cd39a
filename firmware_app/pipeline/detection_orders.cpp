#include "firmware_app/pipeline/detection_orders.h"

namespace godwit::app {

SchedulerOptions counting_frames(SchedulerOptions options) {
  options.detector = true;
  options.frame_ns = 1;
  return options;
}

std::optional<DetectorJob> order_detection(const rt::FrameHandle& frame, bool keyframe, rt::TimeNs now_ns,
                                           Scheduler* scheduler, rt::FrameReturn* back) {
  const auto order = scheduler->order(now_ns, keyframe);
  if (order) return DetectorJob{frame, order->input_px, keyframe};
  back->give_back(frame.slot);
  if (keyframe) scheduler->keyframe_undetected();
  return std::nullopt;
}

}  // namespace godwit::app
