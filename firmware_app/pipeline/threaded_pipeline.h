// The pipeline with a thread for each part: feeder, tracker, mapper; the caller's thread collects.
#pragma once

#include <atomic>
#include <memory>

#include "firmware_app/pipeline/pipeline.h"
#include "hal/rt/spsc_ring.h"
#include "hal/rt/wake_up.h"

namespace godwit::app {

/// Tracks one frame and fills in the record's times. Tracker thread, or the only one.
void track_frame(FrameStage* stage, const rt::FrameHandle& handle, FrameRecord* record);
/// Adds one finished frame to the counters.
void count(const FrameRecord& record, PipelineCounters* counters);

/// One run. See run_pipeline.
class ThreadedPipeline {
 public:
  ThreadedPipeline(hal::Camera* camera, FrameStage* stage, rt::FramePool* pool, const PipelineOptions& options);
  rt::Result<PipelineCounters> run(FrameSink* sink, const std::atomic<bool>& stop);

 private:
  /// Frames between feeder and tracker. Small: a frame that waits here grows old.
  static constexpr std::size_t kFrameRing = 8;
  /// Finished frames that the collector has not taken. The feeder stops at half of it, so that it never overflows:
  /// beyond those counted no more than the frame ring and the frame in work can still come.
  static constexpr std::size_t kRecordRing = 256;
  /// Replay as fast as it goes: the feeder waits while the tracker is so far ahead of the mapper, as it would not be in
  /// flight.
  static constexpr int kMapperBacklog = 2;

  void feed();
  void track();
  void map();
  bool feeder_may_read() const;
  int acquire_patiently();
  void finish(rt::SpscRing<FrameRecord, kRecordRing>* ring, const FrameRecord& record);
  bool collect_one(FrameRecord* record, bool all_done);
  void take_newest(rt::FrameHandle* handle, rt::FrameReturn* tracker_return);

  hal::Camera* camera_;
  FrameStage* stage_;
  rt::FramePool* pool_;
  const bool newest_frame_;
  FrameTap* const tap_;

  rt::SpscRing<rt::FrameHandle, kFrameRing> frames_;                 ///< feeder -> tracker
  std::unique_ptr<rt::SpscRing<FrameRecord, kRecordRing>> fed_;      ///< feeder -> collector: pictures not flown
  std::unique_ptr<rt::SpscRing<FrameRecord, kRecordRing>> tracked_;  ///< tracker -> collector
  rt::WakeUp feeder_wake_, tracker_wake_, mapper_wake_, collector_wake_;

  /// Collector -> feeder: end early. Relaxed; nothing is ordered by it.
  std::atomic<bool> stop_{false};
  /// Each "done" flag is written once by the thread it names, after its last push (release), and read by the next
  /// thread before that one's last look into the ring (acquire). Otherwise the reader could see "done" and an empty
  /// ring while the last item is still on its way, and leave it there.
  std::atomic<bool> feeder_done_{false};
  std::atomic<bool> tracker_done_{false};
  /// Pictures finished by the collector, for the feeder's back pressure. Relaxed; a late value makes the feeder wait
  /// longer, never shorter.
  std::atomic<std::uint64_t> collected_{0};
  /// Tracker -> feeder: frames it is through with, and the mapper's backlog as it last saw it. Relaxed, as above.
  std::atomic<std::uint64_t> tracked_count_{0};
  std::atomic<int> mapper_backlog_{0};
  /// Mapper -> tracker: processor time used by the mapper so far. Relaxed; a figure, nothing is ordered by it.
  std::atomic<rt::TimeNs> mapper_cpu_ns_{0};

  std::uint64_t read_count_ = 0;     ///< feeder's own: pictures read
  std::uint64_t handed_count_ = 0;   ///< feeder's own: frames given to the tracker
  std::uint32_t next_sequence_ = 0;  ///< collector's own
};

}  // namespace godwit::app
