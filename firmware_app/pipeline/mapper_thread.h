// The mapper's thread: one message after the other, whenever the tracker has sent some.
#pragma once

#include "firmware_app/pipeline/channels.h"
#include "firmware_app/pipeline/stage.h"
#include "hal/rt/heartbeat.h"

namespace godwit::app {

class MapperThread {
 public:
  /// Both outlive it.
  MapperThread(FrameStage* stage, Channels* channels) : stage_(stage), channels_(channels) {}

  /// The thread's body: until the tracker's thread has ended. What is left then helps nobody any more.
  void run(rt::Pulse* pulse);

 private:
  FrameStage* const stage_;
  Channels* const channels_;
};

}  // namespace godwit::app
