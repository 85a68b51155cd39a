#include "firmware_app/pipeline/detector_thread.h"

#include <cassert>

#include "firmware_app/pipeline/guarded.h"
#include "firmware_app/pipeline/stage.h"

namespace godwit::app {

bool detect_guarded(DetectorStage* detector, const DetectorJob& job) {
  bool found = false;
  guarded([&] { found = detector->detect(job); });
  return found;
}

void DetectorThread::run() {
  rt::FrameReturn back = pool_->reader(kDetectorReader);
  while (!channels_->tracker_done.load(std::memory_order_acquire)) {
    DetectorJob job;
    if (!channels_->jobs.try_pop(&job)) {
      channels_->detector_wake.wait_for(kSleepNs);
      continue;
    }
    const bool found = detect_guarded(detector_, job);
    back.give_back(job.frame.slot);
    const FoundBoxes* const boxes = found ? detector_->found() : nullptr;
    if (boxes != nullptr && !channels_->found.try_push(*boxes))
      channels_->records_lost.fetch_add(1, std::memory_order_relaxed);
    // Never full: the scheduler gives no second order before the first has come back.
    const bool pushed = channels_->detections.try_push({rt::monotonic_now_ns(), job.frame.meta.t_capture_ns, !found});
    assert(pushed);
    static_cast<void>(pushed);
  }
}

}  // namespace godwit::app
