#include "firmware_app/pipeline/tracker_thread.h"

#include <cassert>
#include <limits>

#include "hal/rt/rt_scope.h"

namespace godwit::app {
namespace {

/// A second of the fastest barometer, and more: what has piled up is old.
constexpr int kMostAids = 128;

SchedulerOptions scheduler_options(const PipelineOptions& options) {
  SchedulerOptions out = options.scheduler;
  out.detector = options.detector != nullptr;
  return out;
}

}  // namespace

TrackerThread::TrackerThread(FrameStage* stage, rt::FramePool* pool, hal::Camera* camera,
                             const PipelineOptions& options, Channels* channels)
    : stage_(stage),
      camera_(camera),
      options_(options),
      channels_(channels),
      pool_(pool),
      readers_(pool->layout().readers),
      back_(pool->reader(kTrackerReader)),
      scheduler_(scheduler_options(options)),
      detections_(options.newest_frame),
      camera_silence_("no picture", "pictures again", kSilenceNs),
      imu_silence_("IMU silent", "IMU heard again", options.imu_silence_ns) {}

void TrackerThread::run(rt::Pulse* pulse) {
  camera_silence_.heard(rt::monotonic_now_ns());
  Channels& c = *channels_;
  {
    const rt::RtScope real_time;
    while (true) {
      // Acquire, partner: the release store in FeederThread::run(). See Channels::feeder_done.
      const bool last_look = c.feeder_done.load(std::memory_order_acquire);
      pulse->beat();
      rt::FrameHandle handle;
      if (!c.frames.try_pop(&handle)) {
        if (last_look) break;
        c.tracker_wake.wait_for(kSleepNs);
        look_around();
        continue;
      }
      track_one(handle);
      c.mapper_backlog.store(stage_->mapper_backlog(), std::memory_order_relaxed);
      c.tracked_count.store(through_, std::memory_order_relaxed);
      c.mapper_wake.post();
      c.feeder_wake.post();
    }
  }
  // Release, partners: the acquire loads of collector, mapper and detector. See Channels::tracker_done.
  c.tracker_done.store(true, std::memory_order_release);
  for (rt::WakeUp* wake : {&c.mapper_wake, &c.detector_wake, &c.collector_wake}) wake->post();
}

void TrackerThread::report(PipelineCounters* counters) const {
  counters->scheduler = scheduler_.counters();
  counters->rung = scheduler_.plan().rung;
  if (counters->imu) counters->imu->silences = imu_silence_.silences();
}

void TrackerThread::track_one(rt::FrameHandle handle) {
  const int dropped = newest_frame() ? take_newest(&handle) : 0;
  take_samples(handle.meta.t_capture_ns + stage_->read_after_ns());
  look_for_imu_silence(handle.meta.t_capture_ns);
  hal::AidSample aid;
  for (int i = 0; i < kMostAids && options_.aids != nullptr; ++i) {
    if (!options_.aids->next_until(handle.meta.t_capture_ns, &aid)) break;
    stage_->take_aid(aid);
  }
  FrameRecord record;
  if (options_.tap != nullptr) options_.tap->frame_begun();
  track_frame(stage_, handle, &record);
  camera_silence_.heard(record.t_done_ns);
  say(camera_silence_.look(record.t_done_ns));
  t_last_capture_ns_ = record.t_capture_ns;
  if (options_.tap != nullptr) options_.tap->frame_done(record);
  say(state_.changed(record));
  if (options_.imu == nullptr) {
    if (const auto rate = turn_.rate(record)) camera_->turning(*rate);
  }
  const rt::TimeNs mapper_cpu = channels_->mapper_cpu_ns.load(std::memory_order_relaxed);
  record.mapper_cpu_ns = mapper_cpu - mapper_cpu_seen_;
  record.stage_ns[kMapStage] = record.mapper_cpu_ns;
  mapper_cpu_seen_ = mapper_cpu;
  look_at_load(&record);
  finish(record);
  steer(record, dropped);
  if (options_.detector != nullptr) look_after_detector(handle, record);
}

int TrackerThread::take_newest(rt::FrameHandle* handle) {
  int dropped = 0;
  rt::FrameHandle newer;
  for (std::size_t i = 0; i < Channels::kFrameRing && channels_->frames.try_pop(&newer); ++i) {
    FrameRecord record;
    record.sequence = handle->meta.sequence;
    record.t_source_ns = handle->meta.t_source_ns;
    record.t_capture_ns = handle->meta.t_capture_ns;
    record.fate = FrameFate::kDroppedLate;
    record.reason.assign("a newer picture had come");
    back_.give_back(handle->slot, readers_);
    finish(record);
    *handle = newer;
    ++dropped;
  }
  return dropped;
}

void TrackerThread::finish(const FrameRecord& record) {
  channels_->finish(&channels_->tracked, record);
  // Release, partner: the acquire load in Collector::take_one(). See Channels::finished.
  channels_->finished.store(++through_, std::memory_order_release);
}

void TrackerThread::look_at_load(FrameRecord* record) const {
  const SchedulerCounters& s = scheduler_.counters();
  LoadRecord& load = record->load;
  load.known = true;
  load.rung = scheduler_.rung();
  load.slips = s.slips;
  load.detections = s.detections;
  load.detections_failed = s.detections_failed;
  load.detections_late = s.detections_late;
  load.detector_stuck = s.detector_stuck;
  load.keyframes_undetected = s.keyframes_undetected;
  load.mask_age_ns = scheduler_.mask_age_ns(record->t_capture_ns);
  load.frames_waiting = static_cast<std::int32_t>(channels_->frames.size());
  load.readings_waiting = static_cast<std::int32_t>(channels_->samples.size());
  load.mapper_backlog = stage_->mapper_backlog();
  load.records_waiting = static_cast<std::int32_t>(channels_->tracked.size());
  load.slots_free = pool_->free_slots();
  load.slots_fewest = pool_->fewest_free_slots();
  load.records_lost = channels_->records_lost.load(std::memory_order_relaxed);
  load.events_lost = channels_->events.lost();
}

void TrackerThread::take_samples(rt::TimeNs until_ns) {
  for (std::size_t i = 0; i < ImuRing::capacity(); ++i) {
    const hal::ImuSample* const sample = channels_->samples.front();
    if (sample == nullptr || sample->t_ns > until_ns) return;
    stage_->take_imu(*sample);
    imu_silence_.heard(sample->t_ns);
    channels_->samples.drop_front();
  }
}

void TrackerThread::look_for_imu_silence(rt::TimeNs now_ns) {
  if (options_.imu == nullptr) return;
  const auto change = imu_silence_.look(now_ns);
  say(change);
  if (change && options_.tap != nullptr) options_.tap->imu_silent(imu_silence_.silent());
}

void TrackerThread::look_around() {
  const rt::TimeNs now_ns = rt::monotonic_now_ns();
  // No frame takes them; the ring must not overflow.
  take_samples(std::numeric_limits<rt::TimeNs>::max());
  // Without a pace times are the recording's, and only frames tell how late it is there.
  if (!newest_frame()) return;
  say(camera_silence_.look(now_ns));
  if (camera_silence_.silent() && options_.tap != nullptr) options_.tap->no_picture(now_ns, t_last_capture_ns_);
  look_for_imu_silence(now_ns);
}

void TrackerThread::steer(const FrameRecord& record, int dropped) {
  DetectionEnd detection;
  while (channels_->detections.try_pop(&detection)) {
    scheduler_.detection_done(detection.t_done_ns, detection.t_capture_ns, detection.failed);
    say(detections_.answered(detection));
  }
  hal::MachineState machine;
  if (channels_->machine.read(&machine)) scheduler_.machine(machine.temperature_c, machine.throttled);
  if (!newest_frame()) return;
  const auto change = scheduler_.frame_done(record.t_done_ns, record.tracked ? record.wall_ns : -1,
                                            record.t_done_ns - record.t_delivered_ns, dropped);
  if (!change) return;
  stage_->limit_features(scheduler_.plan().feature_share);
  const bool down = change->to > change->from;
  say(rt::LogEntry{change->t_ns, down ? rt::LogLevel::kWarning : rt::LogLevel::kInfo, down ? "rung down" : "rung up",
                   rung_name(change->to), rung_reason_name(change->reason), change->value, change->limit,
                   rung_name(change->from)});
}

void TrackerThread::look_after_detector(const rt::FrameHandle& handle, const FrameRecord& record) {
  say(detections_.stuck(scheduler_.detector_stuck(), record.t_capture_ns, scheduler_.mask_age_ns(record.t_done_ns)));
  if (detections_.failed() != detector_failed_) {
    detector_failed_ = detections_.failed();
    if (options_.tap != nullptr) options_.tap->detector_failed(detector_failed_);
  }
  const auto job = order_detection(handle, record.is_keyframe, record.t_done_ns, &scheduler_, &back_);
  if (!job) return;
  // Never full: the scheduler gives no second order before the first has come back.
  const bool pushed = channels_->jobs.try_push(*job);
  assert(pushed);
  static_cast<void>(pushed);
  channels_->detector_wake.post();
}

}  // namespace godwit::app
