// One due picture from the camera into a frame slot.
#pragma once

#include <string>

#include "firmware_app/pipeline/frame_record.h"
#include "hal/camera/camera.h"
#include "hal/rt/frame_pool.h"

namespace godwit::app {

/// The owner's side of the frame pool. One thread.
class Feeder {
 public:
  Feeder(hal::Camera* camera, rt::FramePool* pool) : camera_(camera), pool_(pool) {}

  enum class Outcome {
    kFrame,    ///< *handle holds a frame with kFrameReaders references
    kNoFrame,  ///< a picture was due and is not flown; *record says which and why
    kNothing,  ///< none came in time
    kEnd
  };

  /// Reads the next picture into `slot`, which was acquired from the pool; -1: there is none, the picture is dropped.
  /// Gives the slot back itself unless the outcome is kFrame.
  Outcome read(int slot, rt::TimeNs timeout_ns, rt::FrameHandle* handle, FrameRecord* record);

 private:
  hal::Camera* camera_;
  rt::FramePool* pool_;
  std::string why_;
};

}  // namespace godwit::app
