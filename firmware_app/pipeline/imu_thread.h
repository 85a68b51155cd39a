// The inertial sensor's thread at real pace: each sample to the tracker.
#pragma once

#include "firmware_app/pipeline/channels.h"
#include "firmware_app/pipeline/imu_feeder.h"
#include "firmware_app/pipeline/pipeline.h"
#include "hal/camera/camera.h"
#include "hal/rt/heartbeat.h"

namespace godwit::app {

class ImuThread {
 public:
  /// All outlive it. camera: hears how fast it turns. imu: null where there is none; run() is not called then.
  /// onlooker, tap: may be null.
  ImuThread(hal::Imu* imu, hal::Camera* camera, Onlooker* onlooker, FrameTap* tap, Channels* channels)
      : feeder_(imu, true, onlooker), camera_(camera), tap_(tap), channels_(channels) {}

  /// The thread's body, under real-time rules: until the sensor ends or the camera's thread has.
  void run(rt::Pulse* pulse);
  /// After the join.
  const ImuCounters& counters() const { return feeder_.counters; }

 private:
  ImuFeeder feeder_;
  hal::Camera* const camera_;
  FrameTap* const tap_;
  Channels* const channels_;
};

}  // namespace godwit::app
