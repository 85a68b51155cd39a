#include "firmware_app/pipeline/threaded_pipeline.h"

#include <cassert>
#include <pthread.h>
#include <thread>

#include "firmware_app/pipeline/feeder.h"
#include "hal/rt/rt_scope.h"

namespace godwit::app {
namespace {
/// Longest sleep of a thread without work. Only a safety net: every push is followed by a wake-up call.
constexpr rt::TimeNs kSleepNs = 100 * rt::kNsPerMs;
/// How long the feeder of a replay waits for a slot before it drops the picture after all.
constexpr rt::TimeNs kPatienceNs = 5 * rt::kNsPerSecond;
}  // namespace

ThreadedPipeline::ThreadedPipeline(hal::Camera* camera, FrameStage* stage, rt::FramePool* pool,
                                   const PipelineOptions& options)
    : camera_(camera),
      stage_(stage),
      pool_(pool),
      newest_frame_(options.newest_frame),
      tap_(options.tap),
      fed_(std::make_unique<rt::SpscRing<FrameRecord, kRecordRing>>()),
      tracked_(std::make_unique<rt::SpscRing<FrameRecord, kRecordRing>>()) {}

rt::Result<PipelineCounters> ThreadedPipeline::run(FrameSink* sink, const std::atomic<bool>& stop) {
  std::thread mapper([this] { map(); });
  std::thread tracker([this] { track(); });
  std::thread feeder([this] { feed(); });

  PipelineCounters counters;
  rt::Result<void> taken;
  while (true) {
    // Acquire, partner: the release store in track(). See tracker_done_.
    const bool all_done = tracker_done_.load(std::memory_order_acquire);
    FrameRecord record;
    while (collect_one(&record, all_done)) {
      count(record, &counters);
      if (taken.ok()) taken = sink->take(record);
      collected_.fetch_add(1, std::memory_order_relaxed);
      feeder_wake_.post();
    }
    if (all_done) break;
    if (!taken.ok() || stop.load(std::memory_order_relaxed)) stop_.store(true, std::memory_order_relaxed);
    collector_wake_.wait_for(kSleepNs);
  }
  feeder.join();
  tracker.join();
  mapper.join();
  if (!taken.ok()) return taken.error();
  return counters;
}

bool ThreadedPipeline::feeder_may_read() const {
  if (read_count_ - collected_.load(std::memory_order_relaxed) >= kRecordRing / 2) return false;
  if (newest_frame_) return true;
  return handed_count_ - tracked_count_.load(std::memory_order_relaxed) < 2 &&
         mapper_backlog_.load(std::memory_order_relaxed) <= kMapperBacklog;
}

int ThreadedPipeline::acquire_patiently() {
  if (newest_frame_) return pool_->acquire();
  const rt::TimeNs give_up = rt::monotonic_now_ns() + kPatienceNs;
  while (rt::monotonic_now_ns() < give_up && !stop_.load(std::memory_order_relaxed)) {
    const int slot = pool_->acquire();
    if (slot >= 0) return slot;
    feeder_wake_.wait_for(rt::kNsPerMs);
  }
  return pool_->acquire();
}

void ThreadedPipeline::finish(rt::SpscRing<FrameRecord, kRecordRing>* ring, const FrameRecord& record) {
  const bool pushed = ring->try_push(record);
  assert(pushed);  // see kRecordRing
  static_cast<void>(pushed);
  collector_wake_.post();
}

void ThreadedPipeline::feed() {
  pthread_setname_np(pthread_self(), "gw-feeder");
  Feeder feeder(camera_, pool_);
  while (!stop_.load(std::memory_order_relaxed)) {
    if (!feeder_may_read()) {
      feeder_wake_.wait_for(kSleepNs);
      continue;
    }
    // A full ring: the tracker hangs. The picture is dropped before it takes a slot.
    const bool room = frames_.size() < kFrameRing;
    rt::FrameHandle handle;
    FrameRecord record;
    const Feeder::Outcome outcome = feeder.read(room ? acquire_patiently() : -1, rt::kNsPerSecond, &handle, &record);
    if (outcome == Feeder::Outcome::kEnd) break;
    if (outcome == Feeder::Outcome::kNothing) continue;
    ++read_count_;
    if (outcome == Feeder::Outcome::kNoFrame) {
      if (!room && record.fate == FrameFate::kDroppedSlots) {
        record.fate = FrameFate::kDroppedLate;
        record.reason.assign("the tracker was too many frames behind");
      }
      finish(fed_.get(), record);
      continue;
    }
    ++handed_count_;
    const bool pushed = frames_.try_push(handle);
    assert(pushed);  // only this thread pushes, so the room seen above is still there
    static_cast<void>(pushed);
    tracker_wake_.post();
  }
  // Release, partner: the acquire load in track(). See feeder_done_.
  feeder_done_.store(true, std::memory_order_release);
  tracker_wake_.post();
}

void ThreadedPipeline::take_newest(rt::FrameHandle* handle, rt::FrameReturn* tracker_return) {
  rt::FrameHandle newer;
  for (std::size_t i = 0; i < kFrameRing && frames_.try_pop(&newer); ++i) {
    FrameRecord record;
    record.sequence = handle->meta.sequence;
    record.t_source_ns = handle->meta.t_source_ns;
    record.t_capture_ns = handle->meta.t_capture_ns;
    record.fate = FrameFate::kDroppedLate;
    record.reason.assign("a newer picture had come");
    tracker_return->give_back(handle->slot, kFrameReaders);
    finish(tracked_.get(), record);
    *handle = newer;
  }
}

void ThreadedPipeline::track() {
  pthread_setname_np(pthread_self(), "gw-tracker");
  rt::FrameReturn tracker_return = pool_->reader(kTrackerReader);
  rt::TimeNs mapper_cpu_seen = 0;
  std::uint64_t through = 0;
  while (true) {
    // Acquire, partner: the release store in feed(). See feeder_done_.
    const bool last_look = feeder_done_.load(std::memory_order_acquire);
    rt::FrameHandle handle;
    if (!frames_.try_pop(&handle)) {
      if (last_look) break;
      tracker_wake_.wait_for(kSleepNs);
      continue;
    }
    {
      const rt::RtScope real_time;
      if (newest_frame_) take_newest(&handle, &tracker_return);
      FrameRecord record;
      track_frame(stage_, handle, &record);
      if (tap_ != nullptr) tap_->frame_done(record);
      const rt::TimeNs mapper_cpu = mapper_cpu_ns_.load(std::memory_order_relaxed);
      record.mapper_cpu_ns = mapper_cpu - mapper_cpu_seen;
      record.stage_ns[kMapStage] = record.mapper_cpu_ns;
      mapper_cpu_seen = mapper_cpu;
      finish(tracked_.get(), record);
    }
    mapper_backlog_.store(stage_->mapper_backlog(), std::memory_order_relaxed);
    tracked_count_.store(++through, std::memory_order_relaxed);
    mapper_wake_.post();
    feeder_wake_.post();
  }
  // Release, partners: the acquire loads in run() and map(). See tracker_done_.
  tracker_done_.store(true, std::memory_order_release);
  mapper_wake_.post();
  collector_wake_.post();
}

void ThreadedPipeline::map() {
  pthread_setname_np(pthread_self(), "gw-mapper");
  // What is left when the tracker has ended helps nobody any more.
  while (!tracker_done_.load(std::memory_order_acquire)) {
    if (stage_->map_step()) {
      mapper_cpu_ns_.store(rt::thread_cpu_now_ns(), std::memory_order_relaxed);
      // One message less; the tracker's next look corrects it. Never below zero: the tracker may have looked in
      // between.
      int seen = mapper_backlog_.load(std::memory_order_relaxed);
      while (seen > 0 && !mapper_backlog_.compare_exchange_weak(seen, seen - 1, std::memory_order_relaxed)) {
      }
      feeder_wake_.post();
    } else {
      mapper_backlog_.store(0, std::memory_order_relaxed);
      feeder_wake_.post();
      mapper_wake_.wait_for(kSleepNs);
    }
  }
}

bool ThreadedPipeline::collect_one(FrameRecord* record, bool all_done) {
  const FrameRecord* fed = fed_->front();
  const FrameRecord* tracked = tracked_->front();
  // Two ordered streams into one: the head that is next in line, and when nothing more can come, the older head.
  const bool fed_next = fed != nullptr && fed->sequence == next_sequence_;
  const bool tracked_next = tracked != nullptr && tracked->sequence == next_sequence_;
  bool from_fed = fed_next;
  if (!fed_next && !tracked_next) {
    // A device may skip numbers: with both heads known, or all done, the older one cannot be overtaken any more.
    const bool decided = (fed != nullptr && tracked != nullptr) || all_done;
    if (!decided || (fed == nullptr && tracked == nullptr)) return false;
    from_fed = tracked == nullptr || (fed != nullptr && fed->sequence < tracked->sequence);
  }
  auto* ring = from_fed ? fed_.get() : tracked_.get();
  *record = *ring->front();
  ring->drop_front();
  next_sequence_ = record->sequence + 1;
  return true;
}

}  // namespace godwit::app
