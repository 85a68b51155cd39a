#include "firmware_app/pipeline/sequential_detector.h"

#include "firmware_app/pipeline/detection_orders.h"
#include "firmware_app/pipeline/detector_thread.h"

namespace godwit::app {

namespace {

SchedulerOptions options_of(const PipelineOptions& pipeline) {
  // By count, not by time, where a detection takes none: two runs must be equal.
  if (pipeline.sequential_detection_ns == 0) return counting_frames(pipeline.scheduler);
  SchedulerOptions options = pipeline.scheduler;
  options.detector = true;
  return options;
}

}  // namespace

SequentialDetector::SequentialDetector(const PipelineOptions& options, rt::FramePool* pool, FrameSink* sink)
    : options_(options), sink_(sink), back_(pool->reader(kDetectorReader)), scheduler_(options_of(options)) {}

SequentialDetector::~SequentialDetector() {
  if (under_way_) back_.give_back(under_way_->job.frame.slot);
}

void SequentialDetector::look(const DetectorJob& job, rt::TimeNs done_ns) {
  const bool found = detect_guarded(options_.detector, job);
  back_.give_back(job.frame.slot);
  if (const FoundBoxes* const boxes = found ? options_.detector->found() : nullptr) sink_->detection(*boxes);
  scheduler_.detection_done(done_ns, job.frame.meta.t_capture_ns, !found);
}

void SequentialDetector::before(rt::TimeNs t_capture_ns) {
  if (!under_way_ || t_capture_ns < under_way_->done_ns) return;
  look(under_way_->job, under_way_->done_ns);
  under_way_.reset();
}

void SequentialDetector::after(const rt::FrameHandle& frame, bool keyframe) {
  const bool at_once = options_.sequential_detection_ns == 0;
  const rt::TimeNs now_ns = at_once ? tracked_count_++ : frame.meta.t_capture_ns;
  const auto job = order_detection(frame, keyframe, now_ns, &scheduler_, &back_);
  if (!job) return;
  if (at_once)
    look(*job, now_ns);
  else
    under_way_ = {*job, now_ns + options_.sequential_detection_ns};
}

}  // namespace godwit::app
