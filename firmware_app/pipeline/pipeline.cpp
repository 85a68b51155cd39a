#include "firmware_app/pipeline/pipeline.h"

#include <cassert>

#include "firmware_app/pipeline/feeder.h"
#include "firmware_app/pipeline/state_watch.h"
#include "firmware_app/pipeline/threaded_pipeline.h"
#include "hal/rt/rt_scope.h"

namespace godwit::app {

void count(const FrameRecord& record, PipelineCounters* counters) {
  ++counters->due;
  switch (record.fate) {
    case FrameFate::kProcessed:
      ++counters->processed;
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

rt::Result<PipelineCounters> run_sequential(hal::Camera* camera, FrameStage* stage, rt::FramePool* pool,
                                            const PipelineOptions& options, FrameSink* sink,
                                            const std::atomic<bool>& stop) {
  Feeder feeder(camera, pool, false);
  ImuFeeder imu(options.imu, false);
  StateWatch state;
  PipelineCounters counters;
  int since_detection = options.scheduler.period_frames;
  // Relaxed: the flag orders nothing, it only ends the loop.
  while (!stop.load(std::memory_order_relaxed)) {
    rt::FrameHandle handle;
    FrameRecord record;
    const Feeder::Outcome outcome = feeder.read(pool->acquire(), kCameraWaitNs, &handle, &record);
    if (outcome == Feeder::Outcome::kEnd) break;
    if (outcome == Feeder::Outcome::kNothing) continue;
    if (outcome == Feeder::Outcome::kFrame) {
      {
        const rt::RtScope real_time;
        hal::ImuSample sample;
        while (options.imu != nullptr && imu.next_until(handle.meta.t_capture_ns, &sample)) stage->take_imu(sample);
        track_frame(stage, handle, &record);
        if (options.tap != nullptr) options.tap->frame_done(record);
        const rt::TimeNs before = rt::thread_cpu_now_ns();
        while (stage->map_step()) {
        }
        record.mapper_cpu_ns = rt::thread_cpu_now_ns() - before;
        record.stage_ns[kMapStage] = record.mapper_cpu_ns;
      }
      if (options.detector != nullptr) {
        // By count, not by time: two runs must be equal.
        if (++since_detection >= options.scheduler.period_frames || record.is_keyframe) {
          options.detector->detect({handle, options.scheduler.input_px, record.is_keyframe});
          since_detection = 0;
        }
        pool->reader(kDetectorReader).give_back(handle.slot);
      }
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

void track_frame(FrameStage* stage, const rt::FrameHandle& handle, FrameRecord* record) {
  *record = {};
  record->sequence = handle.meta.sequence;
  record->t_source_ns = handle.meta.t_source_ns;
  record->t_capture_ns = handle.meta.t_capture_ns;
  record->t_delivered_ns = handle.meta.t_delivered_ns;
  const rt::TimeNs wall = rt::monotonic_now_ns();
  const rt::TimeNs cpu = rt::thread_cpu_now_ns();
  stage->track(handle, record);
  record->thread_cpu_ns = rt::thread_cpu_now_ns() - cpu;
  record->t_done_ns = rt::monotonic_now_ns();
  record->wall_ns = record->t_done_ns - wall;
}

rt::Result<PipelineCounters> run_pipeline(hal::Camera* camera, FrameStage* stage, rt::FramePool* pool,
                                          const PipelineOptions& options, FrameSink* sink,
                                          const std::atomic<bool>& stop) {
  assert(pool->layout().readers == (options.detector != nullptr ? kFrameReadersWithDetector : kFrameReaders));
  if (options.sequential) return run_sequential(camera, stage, pool, options, sink, stop);
  ThreadedPipeline pipeline(camera, stage, pool, options);
  return pipeline.run(sink, stop);
}

}  // namespace godwit::app
