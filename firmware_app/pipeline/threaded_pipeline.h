// The pipeline with a thread for each part: feeder, IMU, tracker, mapper, detector; the caller's thread collects.
#pragma once

#include <array>
#include <atomic>
#include <memory>

#include "firmware_app/pipeline/pipeline.h"
#include "firmware_app/pipeline/state_watch.h"
#include "hal/rt/spsc_ring.h"
#include "hal/rt/triple_buffer.h"
#include "hal/rt/wake_up.h"

namespace godwit::app {

/// How long a camera may take to answer: the loops above it look at their stop flag that often.
constexpr rt::TimeNs kCameraWaitNs = 100 * rt::kNsPerMs;

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
  /// Finished frames that the collector has not taken. Replay as fast as it goes: the feeder stops at half of it, so
  /// that it never overflows. Real pace: what finds it full is lost and counted.
  static constexpr std::size_t kRecordRing = 256;
  /// Replay as fast as it goes: the feeder waits while the tracker is so far ahead of the mapper, as it would not be in
  /// flight.
  static constexpr int kMapperBacklog = 2;

  enum ThreadIndex : std::size_t { kFeeder, kTracker, kMapper, kDetector, kImu, kThreads };

  /// A picture that was not flown, and how many frames had been handed to the tracker before it.
  struct Fed {
    FrameRecord record;
    std::uint64_t handed_before = 0;
  };
  /// What the detector thread tells the tracker's.
  struct DetectionEnd {
    rt::TimeNs t_done_ns = 0;
    rt::TimeNs t_capture_ns = 0;
    bool failed = false;
  };

  /// What the log has been told of the detector's answers.
  enum class MasksState { kNone, kComing, kFailing };

  rt::Result<void> start();
  rt::Result<void> start_thread(ThreadIndex index, const char* name, const rt::ThreadPlan& plan,
                                void (ThreadedPipeline::*body)(), rt::TimeNs patience_ns);
  void look_after(FrameSink* sink, rt::TimeNs now_ns);
  void await_end(std::size_t index);
  void join(PipelineCounters* counters);
  void feed();
  void sense();
  void feed_samples(rt::TimeNs t_capture_ns);
  void take_samples(rt::TimeNs until_ns);
  void look_for_imu_silence(rt::TimeNs now_ns);
  void track();
  void map();
  void detect();
  bool feeder_may_read() const;
  int acquire_patiently();
  template <typename Item>
  void finish(rt::SpscRing<Item, kRecordRing>* ring, const Item& item);
  bool collect_one(FrameRecord* record, bool all_done);
  int take_newest(rt::FrameHandle* handle, rt::FrameReturn* tracker_return);
  void track_one(rt::FrameHandle handle, rt::FrameReturn* tracker_return);
  void schedule(const rt::FrameHandle& handle, const FrameRecord& record, int dropped, rt::FrameReturn* tracker_return);
  void order_detection(const rt::FrameHandle& handle, const FrameRecord& record, rt::FrameReturn* tracker_return);
  void note_detection(const DetectionEnd& detection);
  void look_around();
  void look_for_silence(rt::TimeNs now_ns);
  void note_picture(rt::TimeNs now_ns, rt::TimeNs t_capture_ns);

  hal::Camera* camera_;
  FrameStage* stage_;
  rt::FramePool* pool_;
  const PipelineOptions options_;
  const bool newest_frame_;

  rt::SpscRing<rt::FrameHandle, kFrameRing> frames_;                 ///< feeder -> tracker
  std::unique_ptr<ImuRing> samples_;                                 ///< IMU, or feeder -> tracker
  rt::SpscRing<DetectorJob, 2> jobs_;                                ///< tracker -> detector; one under way at a time
  rt::SpscRing<DetectionEnd, 2> detections_;                         ///< detector -> tracker
  rt::TripleBuffer<hal::MachineState> machine_;                      ///< collector -> tracker
  std::unique_ptr<rt::SpscRing<Fed, kRecordRing>> fed_;              ///< feeder -> collector: pictures not flown
  std::unique_ptr<rt::SpscRing<FrameRecord, kRecordRing>> tracked_;  ///< tracker -> collector
  std::unique_ptr<rt::LogRing> events_;                              ///< tracker -> collector
  rt::WakeUp feeder_wake_, tracker_wake_, mapper_wake_, detector_wake_, collector_wake_;
  std::array<rt::Thread, kThreads> threads_;
  /// Each written by the thread it is about, read after that one was joined.
  std::array<rt::PageFaults, kThreads> faults_{};

  std::array<rt::Pulse, kThreads> pulses_;
  /// Each thread -> collector: it has nothing left to do. Release at its end, acquire before the join.
  std::array<std::atomic<bool>, kThreads> ended_{};
  // Collector's own.
  rt::TimeNs t_stop_ns_ = 0;             ///< when the run was told to end; 0: not yet
  const char* silent_thread_ = nullptr;  ///< told to the log as silent
  rt::Pulse collector_pulse_;

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
  /// Tracker -> collector: frames whose records are in the ring, or lost. Release after the push, acquire before the
  /// look: who sees n frames through also finds their records.
  std::atomic<std::uint64_t> finished_{0};
  /// Feeder and tracker -> collector: records that found their ring full. Relaxed; a counter.
  std::atomic<std::uint64_t> records_lost_{0};
  /// Tracker -> feeder: frames it is through with, and the mapper's backlog as it last saw it. Relaxed, as above.
  std::atomic<std::uint64_t> tracked_count_{0};
  std::atomic<int> mapper_backlog_{0};
  /// Mapper -> tracker: processor time used by the mapper so far. Relaxed; a figure, nothing is ordered by it.
  std::atomic<rt::TimeNs> mapper_cpu_ns_{0};

  // Feeder's own.
  std::uint64_t read_count_ = 0;    ///< pictures read
  std::uint64_t handed_count_ = 0;  ///< frames given to the tracker
  ImuFeeder imu_;                   ///< the IMU thread's at real pace, else the feeder's
  // Tracker's own.
  Scheduler scheduler_;
  StateWatch state_;
  rt::TimeNs mapper_cpu_seen_ = 0;
  std::uint64_t through_ = 0;
  rt::TimeNs t_last_capture_ns_ = 0;  ///< of the newest picture flown
  rt::TimeNs t_heard_ns_ = 0;         ///< when it came, or when the run began
  bool silent_ = false;
  bool detector_stuck_ = false;
  bool detector_failed_ = false;  ///< as told: stuck, or without masks
  MasksState masks_state_ = MasksState::kNone;
  /// Keyframes that wait for the detector, oldest first, each with its slot. One makes way when there are more, or when
  /// its mask would come too late. Only this thread uses it.
  rt::SpscRing<rt::FrameHandle, kDetectorSlots - 1> waiting_;
  std::optional<rt::TimeNs> t_imu_ns_;  ///< of the newest sample, or when it was first looked for
  rt::TimeNs t_imu_lost_ns_ = 0;        ///< the same when it was called silent
  bool imu_silent_ = false;
  std::uint64_t imu_silences_ = 0;
};

}  // namespace godwit::app
