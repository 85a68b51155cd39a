#include "firmware_app/pipeline/threaded_pipeline.h"

#include <string>
#include <utility>
#include <vector>

#include "firmware_app/pipeline/collector.h"
#include "hal/rt/process_end.h"

namespace godwit::app {
namespace {
/// Threads that wait for work wake up every kSleepNs; a thread that is silent for longer hangs. The mapper may work on
/// one message for long.
constexpr rt::TimeNs kSilentNs = 500 * rt::kNsPerMs;
constexpr rt::TimeNs kMapperSilentNs = 2 * rt::kNsPerSecond;
}  // namespace

ThreadedPipeline::ThreadedPipeline(hal::Camera* camera, FrameStage* stage, rt::FramePool* pool,
                                   const PipelineOptions& options)
    : camera_(camera),
      options_(options),
      channels_(std::make_unique<Channels>(options.newest_frame)),
      feeder_(camera, pool, options_, stage->read_after_ns(), channels_.get()),
      imu_(options.imu, camera, options.onlooker, options.tap, channels_.get()),
      tracker_(stage, pool, camera, options_, channels_.get()),
      mapper_(stage, channels_.get()),
      detector_(options.detector, pool, channels_.get()),
      threads_{PartThread{"gw-camera", "camera"}, PartThread{"gw-tracker", "tracker"},
               PartThread{"gw-mapper", "mapper"}, PartThread{"gw-detector", "detector"}, PartThread{"gw-imu", "imu"}} {}

rt::Result<void> ThreadedPipeline::start_part(ThreadIndex index, const rt::ThreadPlan& plan, rt::TimeNs patience_ns,
                                              std::function<void(rt::Pulse*)> body) {
  // Only at real pace is somebody late who takes his time.
  rt::Heartbeats* const heartbeats = options_.newest_frame && patience_ns > 0 ? options_.heartbeats : nullptr;
  return threads_[index].start(plan, heartbeats, patience_ns, &channels_->collector_wake, std::move(body));
}

rt::Result<void> ThreadedPipeline::start() {
  const PipelineThreads& plans = options_.threads;
  if (options_.detector != nullptr) {
    // The scheduler finds out when it hangs, and that is no failure of the flight.
    auto r = start_part(kDetector, plans.detector, 0, [this](rt::Pulse*) { detector_.run(); });
    if (!r) return r;
  }
  auto r = start_part(kMapper, plans.mapper, kMapperSilentNs, [this](rt::Pulse* pulse) { mapper_.run(pulse); });
  if (!r) return r;
  r = start_part(kTracker, plans.tracker, kSilentNs, [this](rt::Pulse* pulse) { tracker_.run(pulse); });
  if (!r) return r;
  if (options_.imu != nullptr && options_.newest_frame) {
    r = start_part(kImu, plans.imu, kSilentNs, [this](rt::Pulse* pulse) { imu_.run(pulse); });
    if (!r) return r;
  }
  return start_part(kFeeder, plans.camera, kSilentNs, [this](rt::Pulse* pulse) { feeder_.run(pulse); });
}

// A replay as fast as it goes ends when its mapper is through, however long that takes, unless somebody wants it to
// end. Without anybody to abandon to, the join waits.
void ThreadedPipeline::await_end(const PartThread& thread, const std::atomic<bool>& stop) {
  if (!options_.abandon || !thread.running()) return;
  rt::TimeNs t_wanted_ns = 0;  // when its end was first wanted; 0: not yet
  while (!thread.ended()) {
    const rt::TimeNs now_ns = rt::monotonic_now_ns();
    const bool wanted =
        options_.newest_frame || stop_asked(options_, stop) || channels_->stop.load(std::memory_order_relaxed);
    if (wanted && t_wanted_ns == 0) t_wanted_ns = now_ns;
    if (wanted && now_ns > rt::give_up_ns(t_wanted_ns, kEndPatienceNs)) options_.abandon(thread.name());
    channels_->collector_wake.wait_for(kSleepNs);
  }
}

void ThreadedPipeline::join(const std::atomic<bool>& stop, PipelineCounters* counters) {
  for (PartThread& thread : threads_) {
    await_end(thread, stop);
    thread.join();
    if (thread.report().stack_used > 0) counters->threads.push_back(thread.report());
  }
  counters->records_lost = channels_->records_lost.load(std::memory_order_relaxed);
  counters->events_lost = channels_->events.lost();
  counters->readings_lost = channels_->readings_lost.load(std::memory_order_relaxed);
  if (options_.imu != nullptr) counters->imu = options_.newest_frame ? imu_.counters() : feeder_.imu_counters();
  tracker_.report(counters);
}

rt::Result<PipelineCounters> ThreadedPipeline::run(FrameSink* sink, const std::atomic<bool>& stop) {
  PipelineCounters counters;
  Channels& c = *channels_;
  if (auto started = start(); !started) {
    c.stop.store(true, std::memory_order_relaxed);
    // Whoever runs already waits for one that never will.
    c.feeder_done.store(true, std::memory_order_release);
    c.tracker_done.store(true, std::memory_order_release);
    for (rt::WakeUp* wake : {&c.tracker_wake, &c.mapper_wake, &c.detector_wake}) wake->post();
    join(stop, &counters);
    return started.error();
  }
  std::vector<std::string> refused;
  for (const PartThread& thread : threads_) {
    if (!thread.warning().empty()) refused.push_back(thread.warning());
  }
  Collector collector(camera_, options_, channels_.get(), sink);
  const auto taken = collector.collect(refused, stop, &counters);
  join(stop, &counters);
  collector.take_last();
  if (!taken.ok()) return taken.error();
  return counters;
}

}  // namespace godwit::app
