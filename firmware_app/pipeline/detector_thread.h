// The detector's thread: one picture at a time, however long it takes; nobody waits for it.
#pragma once

#include "firmware_app/pipeline/channels.h"
#include "firmware_app/pipeline/detector_stage.h"
#include "hal/rt/frame_pool.h"

namespace godwit::app {

/// Out of memory, or a library that gives up: there is no mask, and the flight goes on. False: no mask.
bool detect_guarded(DetectorStage* detector, const DetectorJob& job);

class DetectorThread {
 public:
  /// All outlive it. detector: null where there is none; run() is not called then.
  DetectorThread(DetectorStage* detector, rt::FramePool* pool, Channels* channels)
      : detector_(detector), pool_(pool), channels_(channels) {}

  /// The thread's body: until the tracker's thread has ended.
  void run();

 private:
  DetectorStage* const detector_;
  rt::FramePool* const pool_;
  Channels* const channels_;
};

}  // namespace godwit::app
