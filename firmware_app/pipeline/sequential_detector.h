// The detector in a sequential run: at once and by count, or as late as a slow one would be. One thread.
#pragma once

#include <optional>

#include "firmware_app/pipeline/pipeline.h"

namespace godwit::app {

/// Orders, looks and gives out, always in the same frames. options.detector must be there.
///
/// detection_ns of 0: an answer is there before the next picture, and the scheduler counts pictures instead of time.
/// Otherwise the clock is that of the recording: a picture is looked at when the scheduler would let it be, and what is
/// found comes with the first picture captured detection_ns or more after the order, in which the processor of a
/// vehicle is busy. With it a sequential flight has the masks' ages of a flight at real pace, and repeats to the bit.
class SequentialDetector {
 public:
  SequentialDetector(const PipelineOptions& options, rt::FramePool* pool, FrameSink* sink);
  /// What is under way is left, and its picture goes back.
  ~SequentialDetector();
  SequentialDetector(const SequentialDetector&) = delete;
  SequentialDetector& operator=(const SequentialDetector&) = delete;
  /// A picture captured at t_capture_ns is about to be tracked: an answer that is due is given out before it.
  void before(rt::TimeNs t_capture_ns);
  /// It was tracked; its reference for the detector passes over.
  void after(const rt::FrameHandle& frame, bool keyframe);

 private:
  void look(const DetectorJob& job, rt::TimeNs done_ns);

  const PipelineOptions& options_;
  FrameSink* const sink_;
  rt::FrameReturn back_;
  Scheduler scheduler_;
  struct UnderWay {
    DetectorJob job;
    rt::TimeNs done_ns = 0;
  };
  std::optional<UnderWay> under_way_;
  rt::TimeNs tracked_count_ = 0;
};

}  // namespace godwit::app
