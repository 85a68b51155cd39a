// The camera's thread: pictures into frame slots and on to the tracker; without a pace also what the IMU measured.
#pragma once

#include <cstdint>

#include "firmware_app/pipeline/channels.h"
#include "firmware_app/pipeline/feeder.h"
#include "firmware_app/pipeline/pipeline.h"

namespace godwit::app {

class FeederThread {
 public:
  /// All outlive it.
  /// read_after_ns: FrameStage's.
  FeederThread(hal::Camera* camera, rt::FramePool* pool, const PipelineOptions& options, rt::TimeNs read_after_ns,
               Channels* channels)
      : read_after_ns_(read_after_ns),
        real_time_(camera->real_time()),
        pool_(pool),
        channels_(channels),
        feeder_(camera, pool, options.newest_frame, options.onlooker),
        imu_(options.newest_frame ? nullptr : options.imu),
        imu_feeder_(imu_, false, options.onlooker) {}

  /// The thread's body: until the camera ends or Channels::stop. Under real-time rules where the camera is.
  void run(rt::Pulse* pulse);
  /// After the join. Empty: the IMU was not this thread's.
  std::optional<ImuCounters> imu_counters() const {
    return imu_ != nullptr ? std::optional<ImuCounters>(imu_feeder_.counters) : std::nullopt;
  }

 private:
  /// Replay as fast as it goes: the feeder waits while the tracker is so far ahead of the mapper, as it would not be in
  /// flight.
  static constexpr int kMapperBacklog = 2;

  bool may_read() const;
  int acquire_patiently();
  void read_one(Feeder::Outcome* outcome);
  void feed_samples(rt::TimeNs until_ns);

  const rt::TimeNs read_after_ns_;
  const bool real_time_;
  rt::FramePool* const pool_;
  Channels* const channels_;
  Feeder feeder_;
  hal::Imu* const imu_;  ///< null: another thread's, or there is none
  ImuFeeder imu_feeder_;
  std::uint64_t read_count_ = 0;    ///< pictures read
  std::uint64_t handed_count_ = 0;  ///< frames given to the tracker
};

}  // namespace godwit::app
