// One due picture from the camera into a frame slot.
#pragma once

#include <string>

#include "firmware_app/pipeline/frame_record.h"
#include "firmware_app/pipeline/onlooker.h"
#include "hal/camera/camera.h"
#include "hal/rt/frame_pool.h"

namespace godwit::app {

/// How long a camera may take to answer: the loops above it look at their stop flag that often.
constexpr rt::TimeNs kCameraWaitNs = 100 * rt::kNsPerMs;

/// The owner's side of the frame pool. One thread.
class Feeder {
 public:
  /// live: capture times are moments of this machine's clock, so a camera whose clock jumps is found out: a picture of
  /// the future, of long ago, or from before the last one is not flown.
  /// onlooker: may be null.
  Feeder(hal::Camera* camera, rt::FramePool* pool, bool live, Onlooker* onlooker)
      : camera_(camera), pool_(pool), live_(live), onlooker_(onlooker) {
    why_.reserve(256);
  }

  enum class Outcome {
    kFrame,    ///< *handle holds a frame with a reference for each of the pool's readers
    kNoFrame,  ///< a picture was due and is not flown; *record says which and why
    kNothing,  ///< none came in time
    kEnd
  };

  /// Reads the next picture into `slot`, which was acquired from the pool; -1: there is none, the picture is dropped.
  /// Gives the slot back itself unless the outcome is kFrame.
  Outcome read(int slot, rt::TimeNs timeout_ns, rt::FrameHandle* handle, FrameRecord* record);

 private:
  /// What is wrong with this capture time; false: nothing. No allocation.
  bool implausible(rt::TimeNs t_capture_ns, ShortText* why);

  hal::Camera* camera_;
  rt::FramePool* pool_;
  const bool live_;
  Onlooker* const onlooker_;
  rt::TimeNs t_last_ns_ = 0;  ///< capture time of the newest picture that was flown
  std::string why_;
};

}  // namespace godwit::app
