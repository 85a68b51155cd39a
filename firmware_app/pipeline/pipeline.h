// Camera to pose: the way of every frame, in one thread or in several.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "firmware_app/pipeline/detector_stage.h"
#include "firmware_app/pipeline/imu_feeder.h"
#include "firmware_app/pipeline/onlooker.h"
#include "firmware_app/pipeline/stage.h"
#include "firmware_app/scheduler/scheduler.h"
#include "hal/camera/camera.h"
#include "hal/machine/machine_state.h"
#include "hal/rt/frame_pool.h"
#include "hal/rt/heartbeat.h"
#include "hal/rt/log_ring.h"
#include "hal/rt/memory.h"
#include "hal/rt/result.h"
#include "hal/rt/thread.h"

namespace godwit::app {

/// Takes the finished frames, in the order in which they were due. Called by the thread that runs the pipeline, which
/// may block: at real pace what it cannot take in time is lost and counted, and nothing else suffers. An exception out
/// of take() counts as its error, one out of the others is passed over.
class FrameSink {
 public:
  virtual ~FrameSink() = default;
  /// Threads: they run from here on. What the machine refused of their plans, in words, one a thread.
  virtual void started(const std::vector<std::string>& /*refused*/) {}
  /// Error: the run ends with it.
  virtual rt::Result<void> take(const FrameRecord& record) = 0;
  /// Each reading of the inertial sensor, in the order of their times. Not in step with take().
  virtual void reading(const hal::ImuSample& /*sample*/) {}
  /// What the detector found in a picture. Not in step with take().
  virtual void detection(const FoundBoxes& /*found*/) {}
  /// What a real-time thread had to say: changes of state and of rung, a silent camera. In the order in which they
  /// happened, but not in step with take(). The entry's text is static.
  virtual void event(const rt::LogEntry& /*entry*/) {}
  /// Threads: between two looks at what came, at least every 100 ms while the calling thread lives. Where a watchdog is
  /// fed.
  virtual void turn(rt::TimeNs /*now_ns*/) {}
};

/// Hears of each frame at once, before files and logs do: what goes out to the autopilot starts here.
class FrameTap {
 public:
  virtual ~FrameTap() = default;
  /// A frame goes to the tracker now. The same thread and rules as frame_done().
  virtual void frame_begun() {}
  /// A frame went through the tracker. Tracker thread, under its rules: no allocation, no lock, no wait.
  virtual void frame_done(const FrameRecord& record) = 0;
  /// Real pace, the same thread and rules: no picture has been flown since the one captured at t_last_capture_ns (0:
  /// there was none yet), for longer than kSilenceNs; again about ten times a second until one comes. There is no pose:
  /// what was known then must not be sent as if it held.
  virtual void no_picture(rt::TimeNs /*now_ns*/, rt::TimeNs /*t_last_capture_ns*/) {}
  /// The same thread and rules: the inertial sensor fell silent, or is heard again.
  virtual void imu_silent(bool /*silent*/) {}
  /// The same thread and rules: a detection does not end or gives no mask, or masks come again.
  virtual void detector_failed(bool /*failed*/) {}
  /// Real pace: a reading of the inertial sensor, as soon as it is there. That sensor's thread, the same rules.
  virtual void reading(const hal::ImuSample& /*sample*/) {}
};
/// A camera that sends nothing for longer is called silent.
constexpr rt::TimeNs kSilenceNs = 200 * rt::kNsPerMs;

struct PipelineThreads {
  rt::ThreadPlan camera, imu, tracker, mapper, detector;
};

/// How long a thread may take to end.
constexpr rt::TimeNs kEndPatienceNs = 4 * rt::kNsPerSecond;

struct FlownLog;

struct PipelineOptions {
  bool sequential = false;  ///< everything in the calling thread, in a fixed order
  /// Sequential only: what the detector finds comes so much of the recording's time after it was asked; 0: at once.
  rt::TimeNs sequential_detection_ns = 0;
  /// Threads only. True (a camera, or a replay at real pace): the camera is never held up; the tracker takes the newest
  /// frame and older ones are dropped; the scheduler steers. False (replay as fast as it goes): the feeder waits,
  /// nothing is dropped, nothing is shed.
  bool newest_frame = false;
  FrameTap* tap = nullptr;            ///< may be null
  DetectorStage* detector = nullptr;  ///< may be null; with one the pool has kFrameReadersWithDetector readers
  hal::Imu* imu = nullptr;            ///< may be null; real pace: read by a thread of its own
  hal::AidSource* aids = nullptr;     ///< may be null; asked by the tracker before each frame
  /// May be null; gets each picture and reading (pipeline/onlooker.h). With one the pool's layout has an onlooker.
  Onlooker* onlooker = nullptr;
  rt::TimeNs imu_silence_ns = 500 * rt::kNsPerMs;  ///< an IMU of which nothing is newer is called silent
  PipelineThreads threads;                         ///< threads only
  SchedulerOptions scheduler;                      ///< scheduler.detector is set by whether there is one
  const hal::MachineMonitor* machine = nullptr;    ///< may be null; read once a second at real pace
  rt::Heartbeats* heartbeats = nullptr;            ///< may be null; threads at real pace beat in it
  const std::atomic<bool>* also_stop = nullptr;    ///< may be null; a second flag that ends the run
  /// Called in the caller's thread where a thread does not end kEndPatienceNs after it was told to, or by the process's
  /// end where that comes before (hal/rt/process_end.h); must not return. Null: it is waited for, and so is a replay as
  /// fast as it goes that has come to its end by itself.
  std::function<void(const char* thread)> abandon;
  /// May be null; the flight that is flown again (pipeline/as_flown.h), whatever else is said above of threads and
  /// pace.
  const FlownLog* as_flown = nullptr;
};

/// How a flight that was flown again compares with its log.
struct AsFlownCounters {
  std::uint64_t poses = 0;          ///< compared
  std::uint64_t unequal = 0;        ///< frames whose pose, or what they found, is not that of the log to the bit
  std::uint32_t first_unequal = 0;  ///< picture of the first of them
};

/// How one thread fared.
struct ThreadReport {
  const char* name = "";
  rt::PageFaults faults;       ///< from just before its first frame to its end
  std::size_t stack_used = 0;  ///< bytes, deepest
};

struct PipelineCounters {
  std::uint64_t due = 0;        ///< pictures that were due
  std::uint64_t processed = 0;  ///< went through the tracker
  std::uint64_t repeated = 0;   ///< of these: the picture before once more, bit for bit
  std::uint64_t bad = 0;        ///< see FrameFate
  std::uint64_t dropped_slots = 0;
  std::uint64_t dropped_late = 0;
  // Threads only.
  std::uint64_t records_lost = 0;   ///< finished frames that the sink was too slow to take
  std::uint64_t events_lost = 0;    ///< the same of events
  std::uint64_t readings_lost = 0;  ///< the same of readings, for the sink alone: the tracker had them
  SchedulerCounters scheduler;      ///< real pace
  Rung rung = Rung::kFull;          ///< at the end
  std::vector<ThreadReport> threads;
  AsFlownCounters as_flown;
  std::optional<ImuCounters> imu;  ///< if there was one
};

/// Adds one finished frame to the counters.
void count(const FrameRecord& record, PipelineCounters* counters);

/// Runs until the camera is at its end, *stop becomes true or the sink fails. The pool has kFrameReaders readers, one
/// more with a detector.
///
/// Sequential: frame by frame read, track, map, detect, hand to the sink. Threads: feeder -> ring -> tracker -> (the
/// stage's own channel) -> mapper, tracker -> detector, IMU -> ring -> tracker, records through rings to the calling
/// thread. Between two frames threads sleep until there is work; inside a frame nobody waits for anybody. Without a
/// pace, and sequentially, the feeder reads the IMU as well: each frame finds what was measured before it. Error: the
/// sink's, or a thread that could not be started.
rt::Result<PipelineCounters> run_pipeline(hal::Camera* camera, FrameStage* stage, rt::FramePool* pool,
                                          const PipelineOptions& options, FrameSink* sink,
                                          const std::atomic<bool>& stop);

}  // namespace godwit::app
