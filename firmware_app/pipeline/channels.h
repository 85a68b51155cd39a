// All that the pipeline's threads tell each other: each ring, wake-up and flag between two of them, with its two ends.
#pragma once

#include <atomic>
#include <cassert>
#include <cstddef>
#include <cstdint>

#include "firmware_app/pipeline/detector_stage.h"
#include "firmware_app/pipeline/frame_record.h"
#include "firmware_app/pipeline/imu_feeder.h"
#include "hal/machine/machine_state.h"
#include "hal/rt/frame_pool.h"
#include "hal/rt/log_ring.h"
#include "hal/rt/spsc_ring.h"
#include "hal/rt/triple_buffer.h"
#include "hal/rt/wake_up.h"

namespace godwit::app {

/// Longest sleep of a thread without work. Only a safety net: every push is followed by a wake-up call.
constexpr rt::TimeNs kSleepNs = 100 * rt::kNsPerMs;

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

/// Large: create it on the heap, before arming. Outlives all threads of the run.
struct Channels {
  /// Frames between feeder and tracker. Small: a frame that waits here grows old.
  static constexpr std::size_t kFrameRing = 8;
  /// Finished frames that the collector has not taken. Replay as fast as it goes: the feeder stops at half of it, so
  /// that it never overflows. Real pace: what finds it full, after four seconds at 30 pictures a second in which the
  /// collector took nothing, is lost and counted. A record is 2.7 kB, and there are two such rings.
  static constexpr std::size_t kRecordRing = 128;

  explicit Channels(bool at_real_pace) : real_pace(at_real_pace) {}

  /// Feeder and tracker, each into its own ring: a record for the collector. No allocation, no lock.
  template <typename Item>
  void finish(rt::SpscRing<Item, kRecordRing>* ring, const Item& item) {
    const bool pushed = ring->try_push(item);
    assert(pushed || real_pace);  // see kRecordRing
    if (!pushed) records_lost.fetch_add(1, std::memory_order_relaxed);
    collector_wake.post();
  }

  const bool real_pace;  ///< PipelineOptions::newest_frame

  rt::SpscRing<rt::FrameHandle, kFrameRing> frames;  ///< feeder -> tracker
  ImuRing samples;                                   ///< IMU, or feeder -> tracker
  ReadingRing readings;                              ///< IMU, or feeder -> collector
  rt::SpscRing<DetectorJob, 2> jobs;                 ///< tracker -> detector; one under way at a time
  rt::SpscRing<DetectionEnd, 2> detections;          ///< detector -> tracker
  rt::SpscRing<FoundBoxes, 16> found;                ///< detector -> collector
  rt::TripleBuffer<hal::MachineState> machine;       ///< collector -> tracker
  rt::SpscRing<Fed, kRecordRing> fed;                ///< feeder -> collector: pictures not flown
  rt::SpscRing<FrameRecord, kRecordRing> tracked;    ///< tracker -> collector
  rt::LogRing events;                                ///< tracker -> collector
  rt::WakeUp feeder_wake, tracker_wake, mapper_wake, detector_wake, collector_wake;

  /// Collector -> feeder: end early. Relaxed; nothing is ordered by it.
  std::atomic<bool> stop{false};
  /// Each "done" flag is written once by the thread it names, after its last push (release), and read by the next
  /// thread before that one's last look into the ring (acquire). Otherwise the reader could see "done" and an empty
  /// ring while the last item is still on its way, and leave it there.
  std::atomic<bool> feeder_done{false};
  std::atomic<bool> tracker_done{false};
  /// Pictures finished by the collector, for the feeder's back pressure. Relaxed; a late value makes the feeder wait
  /// longer, never shorter.
  std::atomic<std::uint64_t> collected{0};
  /// Tracker -> collector: frames whose records are in the ring, or lost. Release after the push, acquire before the
  /// look: who sees n frames through also finds their records.
  std::atomic<std::uint64_t> finished{0};
  /// Feeder, tracker and detector -> collector: records that found their ring full. Relaxed; a counter.
  std::atomic<std::uint64_t> records_lost{0};
  /// IMU's thread -> collector: readings that found their ring full. Relaxed; a counter.
  std::atomic<std::uint64_t> readings_lost{0};
  /// Tracker -> feeder: frames it is through with, and the mapper's backlog as it last saw it. Relaxed, as above.
  std::atomic<std::uint64_t> tracked_count{0};
  std::atomic<int> mapper_backlog{0};
  /// Mapper -> tracker: processor time used by the mapper so far. Relaxed; a figure, nothing is ordered by it.
  std::atomic<rt::TimeNs> mapper_cpu_ns{0};
};

}  // namespace godwit::app
