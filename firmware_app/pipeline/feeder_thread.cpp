#include "firmware_app/pipeline/feeder_thread.h"

#include <cassert>
#include <optional>

#include "hal/rt/rt_scope.h"

namespace godwit::app {
namespace {
/// How long the feeder of a replay waits for a slot before it drops the picture after all.
constexpr rt::TimeNs kPatienceNs = 5 * rt::kNsPerSecond;
}  // namespace

void FeederThread::run(rt::Pulse* pulse) {
  {
    const std::optional<rt::RtScope> scope = real_time_ ? std::optional<rt::RtScope>(std::in_place) : std::nullopt;
    Feeder::Outcome outcome = Feeder::Outcome::kNothing;
    while (outcome != Feeder::Outcome::kEnd && !channels_->stop.load(std::memory_order_relaxed)) {
      pulse->beat();
      if (may_read()) {
        read_one(&outcome);
      } else {
        channels_->feeder_wake.wait_for(kSleepNs);
      }
    }
  }
  // Release, partner: the acquire load in TrackerThread::run(). See Channels::feeder_done.
  channels_->feeder_done.store(true, std::memory_order_release);
  channels_->tracker_wake.post();
}

void FeederThread::read_one(Feeder::Outcome* outcome) {
  // A full ring: the tracker hangs. The picture is dropped before it takes a slot.
  const bool room = channels_->frames.size() < Channels::kFrameRing;
  rt::FrameHandle handle;
  FrameRecord record;
  *outcome = feeder_.read(room ? acquire_patiently() : -1, kCameraWaitNs, &handle, &record);
  if (*outcome == Feeder::Outcome::kEnd || *outcome == Feeder::Outcome::kNothing) return;
  ++read_count_;
  if (*outcome == Feeder::Outcome::kNoFrame) {
    if (!room && record.fate == FrameFate::kDroppedSlots) {
      record.fate = FrameFate::kDroppedLate;
      record.reason.assign("the tracker was too many frames behind");
    }
    channels_->finish(&channels_->fed, Fed{record, handed_count_});
    return;
  }
  if (imu_ != nullptr) feed_samples(handle.meta.t_capture_ns + read_after_ns_);
  ++handed_count_;
  const bool pushed = channels_->frames.try_push(handle);
  assert(pushed);  // only this thread pushes, so the room seen above is still there
  static_cast<void>(pushed);
  channels_->tracker_wake.post();
}

bool FeederThread::may_read() const {
  if (channels_->real_pace) return true;
  const Channels& c = *channels_;
  if (read_count_ - c.collected.load(std::memory_order_relaxed) >= Channels::kRecordRing / 2) return false;
  return handed_count_ - c.tracked_count.load(std::memory_order_relaxed) < 2 &&
         c.mapper_backlog.load(std::memory_order_relaxed) <= kMapperBacklog;
}

int FeederThread::acquire_patiently() {
  if (channels_->real_pace) return pool_->acquire();
  const rt::TimeNs give_up = rt::monotonic_now_ns() + kPatienceNs;
  while (rt::monotonic_now_ns() < give_up && !channels_->stop.load(std::memory_order_relaxed)) {
    const int slot = pool_->acquire();
    if (slot >= 0) return slot;
    channels_->feeder_wake.wait_for(rt::kNsPerMs);
  }
  return pool_->acquire();
}

void FeederThread::feed_samples(rt::TimeNs until_ns) {
  hal::ImuSample sample;
  while (imu_feeder_.next_until(until_ns, &sample)) {
    while (!channels_->samples.try_push(sample)) {
      if (channels_->stop.load(std::memory_order_relaxed)) return;
      channels_->tracker_wake.post();
      channels_->feeder_wake.wait_for(rt::kNsPerMs);
    }
    while (!channels_->readings.try_push(sample)) {
      if (channels_->stop.load(std::memory_order_relaxed)) return;
      channels_->collector_wake.post();
      channels_->feeder_wake.wait_for(rt::kNsPerMs);
    }
  }
}

}  // namespace godwit::app
