// Camera to pose: the way of every frame, in one thread or in several.
#pragma once

#include <atomic>
#include <cstdint>

#include "firmware_app/pipeline/stage.h"
#include "hal/camera/camera.h"
#include "hal/rt/frame_pool.h"
#include "hal/rt/result.h"

namespace godwit::app {

/// Takes the finished frames, in the order in which they were due. Called by the thread that runs the pipeline.
class FrameSink {
 public:
  virtual ~FrameSink() = default;
  /// Error: the run ends with it.
  virtual rt::Result<void> take(const FrameRecord& record) = 0;
};

/// Hears of each frame at once, before files and logs do: what goes out to the autopilot starts here.
class FrameTap {
 public:
  virtual ~FrameTap() = default;
  /// A frame went through the tracker. Tracker thread, under its rules: no allocation, no lock, no wait.
  virtual void frame_done(const FrameRecord& record) = 0;
};

struct PipelineOptions {
  bool sequential = false;  ///< everything in the calling thread, in a fixed order
  /// Threads only. True (a camera, or a replay at real pace): the camera is never held up; the tracker takes the newest
  /// frame and older ones are dropped. False (replay as fast as it goes): the feeder waits, nothing is dropped.
  bool newest_frame = false;
  FrameTap* tap = nullptr;  ///< may be null
};

struct PipelineCounters {
  std::uint64_t due = 0;        ///< pictures that were due
  std::uint64_t processed = 0;  ///< went through the tracker
  std::uint64_t bad = 0;        ///< see FrameFate
  std::uint64_t dropped_slots = 0;
  std::uint64_t dropped_late = 0;
};

/// Runs until the camera is at its end, *stop becomes true or the sink fails. The pool has kFrameReaders readers.
///
/// Sequential: frame by frame read, track, map, hand to the sink. Threads: feeder -> ring -> tracker -> (the stage's
/// own channel) -> mapper, records through rings to the calling thread. Between two frames threads sleep until there is
/// work; inside a frame nobody waits for anybody. Error: the sink's.
rt::Result<PipelineCounters> run_pipeline(hal::Camera* camera, FrameStage* stage, rt::FramePool* pool,
                                          const PipelineOptions& options, FrameSink* sink,
                                          const std::atomic<bool>& stop);

}  // namespace godwit::app
