// What the pipeline runs on each frame, seen from the threads that run it.
#pragma once

#include "firmware_app/pipeline/frame_record.h"
#include "hal/aid/aid.h"
#include "hal/imu/imu.h"
#include "hal/rt/frame_pool.h"

namespace godwit::app {

/// Frame slots have two references when they reach the stage: the tracker's and the mapper's. The stage gives both back
/// through the readers below, each from its own thread. With a detector there is a third, which the pipeline keeps.
constexpr int kTrackerReader = 0;
constexpr int kMapperReader = 1;
constexpr int kFrameReaders = 2;
constexpr int kDetectorReader = 2;
constexpr int kFrameReadersWithDetector = 3;
/// Frames that the detector may hold: the one it looks at, and the one at hand.
constexpr int kDetectorSlots = 2;

/// Frames that an onlooker (pipeline/onlooker.h) may hold.
constexpr int kOnlookerSlots = 4;

/// Tracker and mapper. Two threads may call it, each its own half, or one thread both.
class FrameStage {
 public:
  virtual ~FrameStage() = default;

  /// Tracker thread. Estimates the frame's pose and fills everything of the record but sequence, times of the frame and
  /// mapper_cpu_ns. No allocation, no lock, bounded. Takes over both references.
  virtual void track(const rt::FrameHandle& frame, FrameRecord* record) = 0;
  /// How long after a frame's capture time its last row is read.
  virtual rt::TimeNs read_after_ns() const { return 0; }
  /// Tracker thread. One reading of the inertial sensor, in the order of their times; what was measured up to a frame's
  /// last row and has come is handed over before that frame, later ones perhaps too. No allocation, no lock, bounded. A
  /// stage without inertial part need not care.
  virtual void take_imu(const hal::ImuSample& /*sample*/) {}
  /// Tracker thread. What knows metres beside the camera (hal/aid/aid.h), under the same terms.
  virtual void take_aid(const hal::AidSample& /*sample*/) {}
  /// Tracker thread. From the next frame on this share of the features is enough; 1: all. A stage without features need
  /// not care.
  virtual void limit_features(double /*share*/) {}
  /// Tracker thread. The next frame finds the mapper like this, and has these features: a flight is flown again. The
  /// mapper is at least as far as it was then. A stage without mapper need not care.
  virtual void expect(const FlownOrder& /*order*/) {}
  /// Tracker thread. Work sent to the mapper and not done yet, in messages.
  virtual int mapper_backlog() const = 0;

  /// Mapper thread. Works on one message; false: there was nothing to do. Bounded.
  virtual bool map_step() = 0;
};

/// Tracks one frame and fills in the record's times. Tracker thread, or the only one; no allocation, no lock.
void track_frame(FrameStage* stage, const rt::FrameHandle& handle, FrameRecord* record);

}  // namespace godwit::app
