// The detector as the pipeline sees it: a picture now and then, on a thread of its own that may take its time.
#pragma once

#include "detector/box.h"
#include "hal/rt/frame_pool.h"
#include "hal/rt/time.h"

namespace godwit::app {

/// One picture to be looked at. The slot is held for the detector until detect() returns.
struct DetectorJob {
  rt::FrameHandle frame;
  int input_px = 0;  ///< size of the network's input: side of the square of as many pixels
  bool is_keyframe = false;
};

/// What was found in one picture.
struct FoundBoxes {
  rt::TimeNs t_capture_ns = 0;
  detector::BoxList boxes;
};

class DetectorStage {
 public:
  virtual ~DetectorStage() = default;
  /// Detector thread. Finds what may move in the job's picture and publishes the mask, with the job's capture time, to
  /// whoever carries it into the tracker (an rt::TripleBuffer; nobody waits). May allocate, lock and take long. False:
  /// there is no mask.
  virtual bool detect(const DetectorJob& job) = 0;
  /// Detector thread, after a detect() that returned true: what it published. Null: it does not tell.
  virtual const FoundBoxes* found() const { return nullptr; }
  /// A flight that is flown again, in the detector thread's place: publishes what was found then.
  virtual void give(const FoundBoxes& /*found*/) {}
};

}  // namespace godwit::app
