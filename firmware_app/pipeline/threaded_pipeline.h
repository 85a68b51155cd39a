// The pipeline with a thread for each part: feeder, IMU, tracker, mapper, detector; the caller's thread collects.
#pragma once

#include <array>
#include <atomic>
#include <functional>
#include <memory>

#include "firmware_app/pipeline/channels.h"
#include "firmware_app/pipeline/detector_thread.h"
#include "firmware_app/pipeline/feeder_thread.h"
#include "firmware_app/pipeline/imu_thread.h"
#include "firmware_app/pipeline/mapper_thread.h"
#include "firmware_app/pipeline/part_thread.h"
#include "firmware_app/pipeline/pipeline.h"
#include "firmware_app/pipeline/tracker_thread.h"

namespace godwit::app {

/// One run. See run_pipeline.
class ThreadedPipeline {
 public:
  ThreadedPipeline(hal::Camera* camera, FrameStage* stage, rt::FramePool* pool, const PipelineOptions& options);
  rt::Result<PipelineCounters> run(FrameSink* sink, const std::atomic<bool>& stop);

 private:
  enum ThreadIndex : std::size_t { kFeeder, kTracker, kMapper, kDetector, kImu, kThreads };

  rt::Result<void> start();
  rt::Result<void> start_part(ThreadIndex index, const rt::ThreadPlan& plan, rt::TimeNs patience_ns,
                              std::function<void(rt::Pulse*)> body);
  void await_end(const PartThread& thread, const std::atomic<bool>& stop);
  void join(const std::atomic<bool>& stop, PipelineCounters* counters);

  hal::Camera* const camera_;
  const PipelineOptions options_;
  const std::unique_ptr<Channels> channels_;
  FeederThread feeder_;
  ImuThread imu_;
  TrackerThread tracker_;
  MapperThread mapper_;
  DetectorThread detector_;
  std::array<PartThread, kThreads> threads_;
};

}  // namespace godwit::app
