#include "firmware_app/pipeline/pipeline.h"

#include <cassert>
#include <optional>

#include "firmware_app/pipeline/as_flown.h"
#include "firmware_app/pipeline/feeder.h"
#include "firmware_app/pipeline/sequential_detector.h"
#include "firmware_app/pipeline/state_watch.h"
#include "firmware_app/pipeline/threaded_pipeline.h"
#include "hal/rt/rt_scope.h"

namespace godwit::app {

void count(const FrameRecord& record, PipelineCounters* counters) {
  ++counters->due;
  switch (record.fate) {
    case FrameFate::kProcessed:
      ++counters->processed;
      if (record.repeated) ++counters->repeated;
      break;
    case FrameFate::kBadPicture:
      ++counters->bad;
      break;
    case FrameFate::kDroppedSlots:
      ++counters->dropped_slots;
      break;
    case FrameFate::kDroppedLate:
      ++counters->dropped_late;
      break;
  }
}

namespace {

/// What the inertial sensor measured up to t_ns, to the stage and, outside the real-time rules, to the sink.
void hand_readings(ImuFeeder* imu, rt::TimeNs t_ns, ReadingRing* told, FrameStage* stage, FrameSink* sink) {
  hal::ImuSample sample;
  for (bool more = true; more;) {
    {
      const rt::RtScope real_time;
      for (more = false; !more && imu->next_until(t_ns, &sample); more = told->size() == ReadingRing::capacity()) {
        stage->take_imu(sample);
        told->try_push(sample);
      }
    }
    while (told->try_pop(&sample)) sink->reading(sample);
  }
}

rt::Result<PipelineCounters> run_sequential(hal::Camera* camera, FrameStage* stage, rt::FramePool* pool,
                                            const PipelineOptions& options, FrameSink* sink,
                                            const std::atomic<bool>& stop) {
  Feeder feeder(camera, pool, false, options.onlooker);
  ImuFeeder imu(options.imu, false, options.onlooker);
  const auto told = std::make_unique<ReadingRing>();
  StateWatch state;
  PipelineCounters counters;
  std::optional<SequentialDetector> detector;
  if (options.detector != nullptr) detector.emplace(options, pool, sink);
  // Relaxed: the flag orders nothing, it only ends the loop.
  while (!stop.load(std::memory_order_relaxed)) {
    rt::FrameHandle handle;
    FrameRecord record;
    const Feeder::Outcome outcome = feeder.read(pool->acquire(), kCameraWaitNs, &handle, &record);
    if (outcome == Feeder::Outcome::kEnd) break;
    if (outcome == Feeder::Outcome::kNothing) continue;
    if (outcome == Feeder::Outcome::kFrame) {
      if (detector) detector->before(handle.meta.t_capture_ns);
      if (options.imu != nullptr)
        hand_readings(&imu, handle.meta.t_capture_ns + stage->read_after_ns(), told.get(), stage, sink);
      {
        const rt::RtScope real_time;
        hal::AidSample aid;
        while (options.aids != nullptr && options.aids->next_until(handle.meta.t_capture_ns, &aid))
          stage->take_aid(aid);
        track_frame(stage, handle, &record);
        if (options.tap != nullptr) options.tap->frame_done(record);
        const rt::TimeNs before = rt::thread_cpu_now_ns();
        while (stage->map_step()) {
        }
        record.mapper_cpu_ns = rt::thread_cpu_now_ns() - before;
        record.stage_ns[kMapStage] = record.mapper_cpu_ns;
      }
      if (detector) detector->after(handle, record.is_keyframe);
    }
    count(record, &counters);
    auto taken = sink->take(record);
    if (!taken) return taken.error();
    if (record.fate != FrameFate::kProcessed) continue;
    if (const auto change = state.changed(record)) sink->event(*change);
  }
  if (options.imu != nullptr) counters.imu = imu.counters;
  return counters;
}

}  // namespace

rt::Result<PipelineCounters> run_pipeline(hal::Camera* camera, FrameStage* stage, rt::FramePool* pool,
                                          const PipelineOptions& options, FrameSink* sink,
                                          const std::atomic<bool>& stop) {
  assert(pool->layout().readers == (options.detector != nullptr ? kFrameReadersWithDetector : kFrameReaders));
  assert(pool->layout().onlooker == (options.onlooker != nullptr));
  if (options.as_flown != nullptr) return run_as_flown(camera, stage, pool, options, sink, stop);
  if (options.sequential) return run_sequential(camera, stage, pool, options, sink, stop);
  ThreadedPipeline pipeline(camera, stage, pool, options);
  return pipeline.run(sink, stop);
}

}  // namespace godwit::app
