#include "firmware_app/pipeline/collector.h"

#include "firmware_app/pipeline/guarded.h"
#include "hal/rt/process_end.h"

namespace godwit::app {
namespace {
/// Files and log may hold the collecting thread up.
constexpr rt::TimeNs kCollectorSilentNs = 3 * rt::kNsPerSecond;
/// How often the machine's temperature is looked at.
constexpr rt::TimeNs kMachineNs = rt::kNsPerSecond;
}  // namespace

rt::Result<void> Collector::collect(const std::vector<std::string>& refused, const std::atomic<bool>& stop,
                                    PipelineCounters* counters) {
  if (options_.heartbeats != nullptr && options_.newest_frame) {
    pulse_ = options_.heartbeats->watch("main", kCollectorSilentNs);
  }
  guarded([&] { sink_->started(refused); });
  while (true) {
    // Acquire, partner: the release store in TrackerThread::run(). See Channels::tracker_done.
    const bool all_done = channels_->tracker_done.load(std::memory_order_acquire);
    take_records(all_done, counters);
    take_events();
    take_detections();
    take_readings();
    if (all_done) break;
    if (!taken_.ok() || stop_asked(options_, stop)) channels_->stop.store(true, std::memory_order_relaxed);
    const rt::TimeNs now_ns = rt::monotonic_now_ns();
    look_at_machine(now_ns);
    pulse_.beat();
    guarded([&] { sink_->turn(now_ns); });
    look_for_silence(now_ns);
    insist_on_end(now_ns);
    channels_->collector_wake.wait_for(kSleepNs);
  }
  pulse_.end();
  return taken_;
}

void Collector::take_records(bool all_done, PipelineCounters* counters) {
  FrameRecord record;
  while (take_one(&record, all_done)) {
    count(record, counters);
    if (taken_.ok()) {
      const std::string thrown = guarded([&] { taken_ = sink_->take(record); });
      if (!thrown.empty()) taken_ = rt::Error{thrown};
    }
    channels_->collected.fetch_add(1, std::memory_order_relaxed);
    channels_->feeder_wake.post();
  }
}

// Two ordered streams into one. A tracked frame never waits for the other stream: whatever the feeder put aside before
// it handed that frame over is visible by now. A picture put aside waits until the frames handed over before it are
// finished.
bool Collector::take_one(FrameRecord* record, bool all_done) {
  // Acquire, partner: the release store in TrackerThread::finish(). Read before the rings: see Channels::finished.
  const std::uint64_t finished = channels_->finished.load(std::memory_order_acquire);
  const FrameRecord* tracked = channels_->tracked.front();
  const Fed* fed = channels_->fed.front();
  const bool fed_first = fed != nullptr && (tracked != nullptr ? fed->record.sequence < tracked->sequence
                                                               : all_done || fed->handed_before <= finished);
  if (fed_first) {
    *record = fed->record;
    channels_->fed.drop_front();
    return true;
  }
  if (tracked == nullptr) return false;
  *record = *tracked;
  channels_->tracked.drop_front();
  return true;
}

void Collector::take_events() {
  rt::LogEntry event;
  for (rt::LogRing* const ring :
       {&channels_->events, camera_->events(), options_.imu != nullptr ? options_.imu->events() : nullptr}) {
    while (ring != nullptr && ring->take(&event)) guarded([&] { sink_->event(event); });
  }
}

void Collector::take_detections() {
  FoundBoxes found;
  while (channels_->found.try_pop(&found)) guarded([&] { sink_->detection(found); });
}

void Collector::take_readings() {
  hal::ImuSample sample;
  while (channels_->readings.try_pop(&sample)) guarded([&] { sink_->reading(sample); });
}

void Collector::take_last() {
  take_detections();
  take_readings();
}

void Collector::look_at_machine(rt::TimeNs now_ns) {
  if (options_.machine == nullptr || !options_.newest_frame || now_ns < t_machine_due_ns_) return;
  guarded([&] { channels_->machine.write(options_.machine->read()); });
  t_machine_due_ns_ = now_ns + kMachineNs;
}

void Collector::look_for_silence(rt::TimeNs now_ns) {
  if (options_.heartbeats == nullptr) return;
  const rt::Heartbeats::Silent silent = options_.heartbeats->silent(now_ns);
  if (silent.name != nullptr && silent.name != silent_thread_) {
    guarded([&] {
      sink_->event({now_ns, rt::LogLevel::kWarning, "no sign of life of", silent.name, "for [s]",
                    rt::to_seconds(silent.for_ns), 0});
    });
  } else if (silent.name == nullptr && silent_thread_ != nullptr) {
    guarded([&] { sink_->event({now_ns, rt::LogLevel::kInfo, "all threads live again"}); });
  }
  silent_thread_ = silent.name;
}

// Told to end, and it does not: the tracker ends after the camera, the others are looked at when they are joined.
void Collector::insist_on_end(rt::TimeNs now_ns) {
  if (!channels_->stop.load(std::memory_order_relaxed) || !options_.abandon) return;
  if (t_stop_ns_ == 0) t_stop_ns_ = now_ns;
  if (now_ns <= rt::give_up_ns(t_stop_ns_, kEndPatienceNs)) return;
  options_.abandon(channels_->feeder_done.load(std::memory_order_acquire) ? "gw-tracker" : "gw-camera");
}

}  // namespace godwit::app
