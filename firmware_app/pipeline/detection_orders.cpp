#include "firmware_app/pipeline/detection_orders.h"

namespace godwit::app {

SchedulerOptions counting_frames(SchedulerOptions options) {
  options.detector = true;
  options.frame_ns = 1;
  return options;
}

void DetectionOrders::forget_oldest(Scheduler* scheduler, rt::FrameReturn* back) {
  back->give_back(waiting_.front()->slot);
  waiting_.drop_front();
  scheduler->keyframe_undetected();
}

std::optional<DetectorJob> DetectionOrders::next(const rt::FrameHandle& frame, bool keyframe, rt::TimeNs now_ns,
                                                 Scheduler* scheduler, rt::FrameReturn* back) {
  const auto too_old = [&](rt::TimeNs t_capture_ns) {
    return real_pace_ ? scheduler->too_old_to_detect(now_ns - t_capture_ns)
                      : frame.meta.t_capture_ns - t_capture_ns > mask_age_ns_;
  };
  while (waiting_.front() != nullptr && too_old(waiting_.front()->meta.t_capture_ns)) forget_oldest(scheduler, back);
  if (keyframe) {
    if (waiting_.size() == waiting_.capacity()) forget_oldest(scheduler, back);
    waiting_.try_push(frame);
  }
  const rt::FrameHandle* const oldest = waiting_.front();
  const auto order = scheduler->order(now_ns, oldest != nullptr);
  // The detector's side gives back what it gets; a keyframe's slot is kept while it waits.
  if (!keyframe && (!order || oldest != nullptr)) back->give_back(frame.slot);
  if (!order) return std::nullopt;
  const DetectorJob job{oldest != nullptr ? *oldest : frame, order->input_px, oldest != nullptr};
  if (oldest != nullptr) waiting_.drop_front();
  return job;
}

}  // namespace godwit::app
