// The tracker's thread: the newest picture through the odometry, and what follows from it for ladder, detector and log.
#pragma once

#include <cstdint>

#include "firmware_app/pipeline/channels.h"
#include "firmware_app/pipeline/detection_orders.h"
#include "firmware_app/pipeline/detection_watch.h"
#include "firmware_app/pipeline/pipeline.h"
#include "firmware_app/pipeline/silence_watch.h"
#include "firmware_app/pipeline/state_watch.h"
#include "firmware_app/pipeline/turn_watch.h"
#include "firmware_app/scheduler/scheduler.h"
#include "hal/camera/camera.h"

namespace godwit::app {

class TrackerThread {
 public:
  /// All outlive it. camera: hears how fast it turns where no IMU says it.
  TrackerThread(FrameStage* stage, rt::FramePool* pool, hal::Camera* camera, const PipelineOptions& options,
                Channels* channels);

  /// The thread's body, under real-time rules: until the camera's thread has ended and its last frame is through.
  void run(rt::Pulse* pulse);
  /// After the join: what the ladder did, and how often the IMU fell silent.
  void report(PipelineCounters* counters) const;

 private:
  bool newest_frame() const { return options_.newest_frame; }
  void say(const std::optional<rt::LogEntry>& entry) {
    if (entry) channels_->events.say(*entry);
  }
  void track_one(rt::FrameHandle handle);
  int take_newest(rt::FrameHandle* handle);
  void finish(const FrameRecord& record);
  void look_at_load(FrameRecord* record) const;
  void take_samples(rt::TimeNs until_ns);
  void look_around();
  void look_for_imu_silence(rt::TimeNs now_ns);
  void steer(const FrameRecord& record, int dropped);
  void look_after_detector(const rt::FrameHandle& handle, const FrameRecord& record);

  FrameStage* const stage_;
  hal::Camera* const camera_;
  TurnWatch turn_;
  const PipelineOptions& options_;
  Channels* const channels_;
  const rt::FramePool* const pool_;
  const int readers_;     ///< references to a frame
  rt::FrameReturn back_;  ///< this thread's way of giving slots back
  Scheduler scheduler_;
  DetectionWatch detections_;
  bool detector_failed_ = false;  ///< as the tap was told
  StateWatch state_;
  SilenceWatch camera_silence_, imu_silence_;
  rt::TimeNs t_last_capture_ns_ = 0;  ///< of the newest picture flown
  rt::TimeNs mapper_cpu_seen_ = 0;
  std::uint64_t through_ = 0;  ///< frames
};

}  // namespace godwit::app
