#include "firmware_app/pipeline/threaded_pipeline.h"

#include <cassert>
#include <exception>
#include <limits>
#include <string>

#include "firmware_app/pipeline/feeder.h"
#include "hal/rt/rt_scope.h"

namespace godwit::app {
namespace {
/// Longest sleep of a thread without work. Only a safety net: every push is followed by a wake-up call.
constexpr rt::TimeNs kSleepNs = 100 * rt::kNsPerMs;
/// How long the feeder of a replay waits for a slot before it drops the picture after all.
constexpr rt::TimeNs kPatienceNs = 5 * rt::kNsPerSecond;
/// How long the IMU may take to answer, and how long it is left alone after a fault.
constexpr rt::TimeNs kImuWaitNs = 50 * rt::kNsPerMs;
constexpr rt::TimeNs kImuFaultNs = rt::kNsPerMs;
/// Threads that wait for work wake up every kSleepNs; a thread that is silent for longer hangs. The mapper may work on
/// one message for long; files and log may hold the collecting thread up.
constexpr rt::TimeNs kSilentNs = 500 * rt::kNsPerMs;
constexpr rt::TimeNs kMapperSilentNs = 2 * rt::kNsPerSecond;
constexpr rt::TimeNs kCollectorSilentNs = 3 * rt::kNsPerSecond;
/// How often the machine's temperature is looked at.
constexpr rt::TimeNs kMachineNs = rt::kNsPerSecond;

/// What a sink throws must not unwind past running threads. What it said; empty: nothing was thrown.
template <typename Call>
std::string guarded(Call call) {
  try {
    call();
    return "";
  } catch (const std::exception& e) {
    return e.what()[0] != '\0' ? e.what() : "an exception without a word";
  }
}

SchedulerOptions scheduler_options(const PipelineOptions& options) {
  SchedulerOptions out = options.scheduler;
  out.detector = options.detector != nullptr;
  return out;
}
}  // namespace

ThreadedPipeline::ThreadedPipeline(hal::Camera* camera, FrameStage* stage, rt::FramePool* pool,
                                   const PipelineOptions& options)
    : camera_(camera),
      stage_(stage),
      pool_(pool),
      options_(options),
      newest_frame_(options.newest_frame),
      samples_(std::make_unique<ImuRing>()),
      fed_(std::make_unique<rt::SpscRing<Fed, kRecordRing>>()),
      tracked_(std::make_unique<rt::SpscRing<FrameRecord, kRecordRing>>()),
      events_(std::make_unique<rt::LogRing>()),
      imu_(options.imu, options.newest_frame),
      scheduler_(scheduler_options(options)) {}

rt::Result<void> ThreadedPipeline::start_thread(ThreadIndex index, const char* name, const rt::ThreadPlan& plan,
                                                void (ThreadedPipeline::*body)(), rt::TimeNs patience_ns) {
  // Only at real pace is somebody late who takes his time.
  if (options_.heartbeats != nullptr && newest_frame_ && patience_ns > 0) {
    pulses_[index] = options_.heartbeats->watch(name, patience_ns);
  }
  auto started = threads_[index].start(name, plan, [this, index, body] {
    (this->*body)();
    pulses_[index].end();
    ended_[index].store(true, std::memory_order_release);
    collector_wake_.post();
  });
  if (!started) pulses_[index].end();
  return started;
}

rt::Result<void> ThreadedPipeline::start() {
  using P = ThreadedPipeline;
  const PipelineThreads& plans = options_.threads;
  if (options_.detector != nullptr) {
    // The scheduler finds out when it hangs, and that is no failure of the flight.
    if (auto r = start_thread(kDetector, "gw-detector", plans.detector, &P::detect, 0); !r) return r;
  }
  if (auto r = start_thread(kMapper, "gw-mapper", plans.mapper, &P::map, kMapperSilentNs); !r) return r;
  if (auto r = start_thread(kTracker, "gw-tracker", plans.tracker, &P::track, kSilentNs); !r) return r;
  if (options_.imu != nullptr && newest_frame_) {
    if (auto r = start_thread(kImu, "gw-imu", plans.imu, &P::sense, kSilentNs); !r) return r;
  }
  return start_thread(kFeeder, "gw-camera", plans.camera, &P::feed, kSilentNs);
}

// Without anybody to abandon to, the join waits.
void ThreadedPipeline::await_end(std::size_t index) {
  constexpr const char* kThreadNames[kThreads] = {"gw-camera", "gw-tracker", "gw-mapper", "gw-detector", "gw-imu"};
  if (!options_.abandon || !threads_[index].running()) return;
  const rt::TimeNs give_up = rt::monotonic_now_ns() + kEndPatienceNs;
  // Acquire, partner: the release store in start_thread().
  while (!ended_[index].load(std::memory_order_acquire)) {
    if (rt::monotonic_now_ns() > give_up) options_.abandon(kThreadNames[index]);
    collector_wake_.wait_for(kSleepNs);
  }
}

void ThreadedPipeline::join(PipelineCounters* counters) {
  constexpr const char* kNames[kThreads] = {"camera", "tracker", "mapper", "detector", "imu"};
  for (std::size_t i = 0; i < kThreads; ++i) {
    await_end(i);
    threads_[i].join();
    if (threads_[i].stack_used() > 0) counters->threads.push_back({kNames[i], faults_[i], threads_[i].stack_used()});
  }
  counters->records_lost = records_lost_.load(std::memory_order_relaxed);
  counters->events_lost = events_->lost();
  if (options_.imu != nullptr) {
    counters->imu = imu_.counters;
    counters->imu->silences = imu_silences_;
  }
  counters->scheduler = scheduler_.counters();
  counters->rung = scheduler_.plan().rung;
}

rt::Result<PipelineCounters> ThreadedPipeline::run(FrameSink* sink, const std::atomic<bool>& stop) {
  PipelineCounters counters;
  if (auto started = start(); !started) {
    stop_.store(true, std::memory_order_relaxed);
    // Whoever runs already waits for one that never will.
    feeder_done_.store(true, std::memory_order_release);
    tracker_done_.store(true, std::memory_order_release);
    for (rt::WakeUp* wake : {&tracker_wake_, &mapper_wake_, &detector_wake_}) wake->post();
    join(&counters);
    return started.error();
  }
  std::vector<std::string> refused;
  for (const rt::Thread& thread : threads_) {
    if (!thread.warning().empty()) refused.push_back(thread.warning());
  }
  if (options_.heartbeats != nullptr && newest_frame_) {
    collector_pulse_ = options_.heartbeats->watch("main", kCollectorSilentNs);
  }
  rt::Result<void> taken;
  guarded([&] { sink->started(refused); });
  rt::TimeNs machine_due_ns = 0;
  while (true) {
    // Acquire, partner: the release store in track(). See tracker_done_.
    const bool all_done = tracker_done_.load(std::memory_order_acquire);
    FrameRecord record;
    while (collect_one(&record, all_done)) {
      count(record, &counters);
      if (taken.ok()) {
        const std::string thrown = guarded([&] { taken = sink->take(record); });
        if (!thrown.empty()) taken = rt::Error{thrown};
      }
      collected_.fetch_add(1, std::memory_order_relaxed);
      feeder_wake_.post();
    }
    rt::LogEntry event;
    for (rt::LogRing* const ring :
         {events_.get(), camera_->events(), options_.imu != nullptr ? options_.imu->events() : nullptr}) {
      while (ring != nullptr && ring->take(&event)) guarded([&] { sink->event(event); });
    }
    if (all_done) break;
    const bool told = stop.load(std::memory_order_relaxed) ||
                      (options_.also_stop != nullptr && options_.also_stop->load(std::memory_order_relaxed));
    if (!taken.ok() || told) stop_.store(true, std::memory_order_relaxed);
    const rt::TimeNs now_ns = rt::monotonic_now_ns();
    if (options_.machine != nullptr && newest_frame_ && now_ns >= machine_due_ns) {
      guarded([&] { machine_.write(options_.machine->read()); });
      machine_due_ns = now_ns + kMachineNs;
    }
    look_after(sink, now_ns);
    collector_wake_.wait_for(kSleepNs);
  }
  collector_pulse_.end();
  join(&counters);
  if (!taken.ok()) return taken.error();
  return counters;
}

void ThreadedPipeline::look_after(FrameSink* sink, rt::TimeNs now_ns) {
  collector_pulse_.beat();
  guarded([&] { sink->turn(now_ns); });
  if (options_.heartbeats != nullptr) {
    const rt::Heartbeats::Silent silent = options_.heartbeats->silent(now_ns);
    if (silent.name != nullptr && silent.name != silent_thread_) {
      guarded([&] {
        sink->event({now_ns, rt::LogLevel::kWarning, "no sign of life of", silent.name, "for [s]",
                     rt::to_seconds(silent.for_ns), 0});
      });
    } else if (silent.name == nullptr && silent_thread_ != nullptr) {
      guarded([&] { sink->event({now_ns, rt::LogLevel::kInfo, "all threads live again"}); });
    }
    silent_thread_ = silent.name;
  }
  // Told to end, and it does not: the tracker ends after the camera, the others are looked at when they are joined.
  if (!stop_.load(std::memory_order_relaxed) || !options_.abandon) return;
  if (t_stop_ns_ == 0) t_stop_ns_ = now_ns;
  if (now_ns - t_stop_ns_ <= kEndPatienceNs) return;
  options_.abandon(ended_[kFeeder].load(std::memory_order_acquire) ? "gw-tracker" : "gw-camera");
}

bool ThreadedPipeline::feeder_may_read() const {
  if (newest_frame_) return true;
  if (read_count_ - collected_.load(std::memory_order_relaxed) >= kRecordRing / 2) return false;
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

template <typename Item>
void ThreadedPipeline::finish(rt::SpscRing<Item, kRecordRing>* ring, const Item& item) {
  const bool pushed = ring->try_push(item);
  assert(pushed || newest_frame_);  // see kRecordRing
  if (!pushed) records_lost_.fetch_add(1, std::memory_order_relaxed);
  collector_wake_.post();
}

void ThreadedPipeline::feed() {
  Feeder feeder(camera_, pool_, newest_frame_);
  const rt::PageFaults before = rt::thread_page_faults();
  const std::optional<rt::RtScope> real_time =
      camera_->real_time() ? std::optional<rt::RtScope>(std::in_place) : std::nullopt;
  while (!stop_.load(std::memory_order_relaxed)) {
    pulses_[kFeeder].beat();
    if (!feeder_may_read()) {
      feeder_wake_.wait_for(kSleepNs);
      continue;
    }
    // A full ring: the tracker hangs. The picture is dropped before it takes a slot.
    const bool room = frames_.size() < kFrameRing;
    rt::FrameHandle handle;
    FrameRecord record;
    const Feeder::Outcome outcome = feeder.read(room ? acquire_patiently() : -1, kCameraWaitNs, &handle, &record);
    if (outcome == Feeder::Outcome::kEnd) break;
    if (outcome == Feeder::Outcome::kNothing) continue;
    ++read_count_;
    if (outcome == Feeder::Outcome::kNoFrame) {
      if (!room && record.fate == FrameFate::kDroppedSlots) {
        record.fate = FrameFate::kDroppedLate;
        record.reason.assign("the tracker was too many frames behind");
      }
      finish(fed_.get(), Fed{record, handed_count_});
      continue;
    }
    if (options_.imu != nullptr && !newest_frame_) feed_samples(handle.meta.t_capture_ns);
    ++handed_count_;
    const bool pushed = frames_.try_push(handle);
    assert(pushed);  // only this thread pushes, so the room seen above is still there
    static_cast<void>(pushed);
    tracker_wake_.post();
  }
  faults_[kFeeder] = rt::thread_page_faults() - before;
  // Release, partner: the acquire load in track(). See feeder_done_.
  feeder_done_.store(true, std::memory_order_release);
  tracker_wake_.post();
}

void ThreadedPipeline::feed_samples(rt::TimeNs t_capture_ns) {
  hal::ImuSample sample;
  while (imu_.next_until(t_capture_ns, &sample)) {
    while (!samples_->try_push(sample)) {
      if (stop_.load(std::memory_order_relaxed)) return;
      tracker_wake_.post();
      feeder_wake_.wait_for(rt::kNsPerMs);
    }
  }
}

void ThreadedPipeline::sense() {
  const rt::PageFaults before = rt::thread_page_faults();
  const rt::RtScope real_time;
  hal::ImuStatus status = hal::ImuStatus::kTimeout;
  // Relaxed: nothing is ordered by it, it only ends the loop.
  while (status != hal::ImuStatus::kEnd && !feeder_done_.load(std::memory_order_relaxed)) {
    pulses_[kImu].beat();
    hal::ImuSample sample;
    status = imu_.next(&sample, kImuWaitNs);
    if (status == hal::ImuStatus::kSample && !samples_->try_push(sample)) ++imu_.counters.dropped;
    // A device that fails at once must not take the processor.
    if (status == hal::ImuStatus::kFault) rt::sleep_until_ns(rt::monotonic_now_ns() + kImuFaultNs);
  }
  faults_[kImu] = rt::thread_page_faults() - before;
}

void ThreadedPipeline::take_samples(rt::TimeNs until_ns) {
  for (std::size_t i = 0; i < ImuRing::capacity(); ++i) {
    const hal::ImuSample* const sample = samples_->front();
    if (sample == nullptr || sample->t_ns > until_ns) return;
    stage_->take_imu(*sample);
    t_imu_ns_ = sample->t_ns;
    samples_->drop_front();
  }
}

void ThreadedPipeline::look_for_imu_silence(rt::TimeNs now_ns) {
  if (options_.imu == nullptr) return;
  if (!t_imu_ns_) t_imu_ns_ = now_ns;
  const rt::TimeNs age = now_ns - *t_imu_ns_;
  const bool silent = age > options_.imu_silence_ns;
  if (silent == imu_silent_) return;
  imu_silent_ = silent;
  if (silent) {
    ++imu_silences_;
    t_imu_lost_ns_ = *t_imu_ns_;
    events_->say({now_ns, rt::LogLevel::kWarning, "IMU silent", "", "for [s]", rt::to_seconds(age),
                  rt::to_seconds(options_.imu_silence_ns)});
  } else {
    events_->say({now_ns, rt::LogLevel::kInfo, "IMU heard again", "", "after [s]",
                  rt::to_seconds(*t_imu_ns_ - t_imu_lost_ns_), 0});
  }
  if (options_.tap != nullptr) options_.tap->imu_silent(silent);
}

int ThreadedPipeline::take_newest(rt::FrameHandle* handle, rt::FrameReturn* tracker_return) {
  int dropped = 0;
  rt::FrameHandle newer;
  for (std::size_t i = 0; i < kFrameRing && frames_.try_pop(&newer); ++i) {
    FrameRecord record;
    record.sequence = handle->meta.sequence;
    record.t_source_ns = handle->meta.t_source_ns;
    record.t_capture_ns = handle->meta.t_capture_ns;
    record.fate = FrameFate::kDroppedLate;
    record.reason.assign("a newer picture had come");
    tracker_return->give_back(handle->slot, pool_->layout().readers);
    finish(tracked_.get(), record);
    finished_.store(++through_, std::memory_order_release);
    *handle = newer;
    ++dropped;
  }
  return dropped;
}

void ThreadedPipeline::schedule(const rt::FrameHandle& handle, const FrameRecord& record, int dropped,
                                rt::FrameReturn* tracker_return) {
  DetectionEnd detection;
  while (detections_.try_pop(&detection)) {
    scheduler_.detection_done(detection.t_done_ns, detection.t_capture_ns, detection.failed);
    note_detection(detection);
  }
  hal::MachineState machine;
  if (machine_.read(&machine)) scheduler_.machine(machine.temperature_c, machine.throttled);
  if (newest_frame_) {
    const auto change = scheduler_.frame_done(record.t_done_ns, record.tracked ? record.wall_ns : -1,
                                              record.t_done_ns - record.t_delivered_ns, dropped);
    if (change) {
      stage_->limit_features(scheduler_.plan().feature_share);
      const bool down = change->to > change->from;
      events_->say({change->t_ns, down ? rt::LogLevel::kWarning : rt::LogLevel::kInfo, down ? "rung down" : "rung up",
                    rung_name(change->to), rung_reason_name(change->reason), change->value, change->limit,
                    rung_name(change->from)});
    }
  }
  if (options_.detector == nullptr) return;
  if (scheduler_.detector_stuck() != detector_stuck_) {
    detector_stuck_ = !detector_stuck_;
    events_->say({record.t_capture_ns, detector_stuck_ ? rt::LogLevel::kWarning : rt::LogLevel::kInfo,
                  detector_stuck_ ? "detector hangs" : "detector is back", "", "age of the mask [s]",
                  rt::to_seconds(scheduler_.mask_age_ns(record.t_done_ns)), 0});
  }
  const bool failed = detector_stuck_ || masks_state_ == MasksState::kFailing;
  if (failed != detector_failed_ && options_.tap != nullptr) options_.tap->detector_failed(failed);
  detector_failed_ = failed;
  order_detection(handle, record, tracker_return);
}

void ThreadedPipeline::order_detection(const rt::FrameHandle& handle, const FrameRecord& record,
                                       rt::FrameReturn* tracker_return) {
  const auto forget_oldest = [&] {
    tracker_return->give_back(waiting_.front()->slot);
    waiting_.drop_front();
    scheduler_.keyframe_undetected();
  };
  // Without a pace what a detection takes says nothing of the recording's time.
  const auto too_old = [&](const rt::FrameHandle& frame) {
    const rt::TimeNs t = frame.meta.t_capture_ns;
    return newest_frame_ ? scheduler_.too_old_to_detect(record.t_done_ns - t)
                         : handle.meta.t_capture_ns - t > options_.scheduler.mask_age_ns;
  };
  while (waiting_.front() != nullptr && too_old(*waiting_.front())) forget_oldest();
  if (record.is_keyframe) {
    if (waiting_.size() == waiting_.capacity()) forget_oldest();
    waiting_.try_push(handle);
  }
  const rt::FrameHandle* const keyframe = waiting_.front();
  const auto order = scheduler_.order(record.t_done_ns, keyframe != nullptr);
  const bool ordered =
      order && jobs_.try_push({keyframe != nullptr ? *keyframe : handle, order->input_px, keyframe != nullptr});
  // The detector gives back what it gets; a keyframe's slot is kept while it waits.
  if (!record.is_keyframe && (!ordered || keyframe != nullptr)) tracker_return->give_back(handle.slot);
  if (!ordered) return;
  if (keyframe != nullptr) waiting_.drop_front();
  detector_wake_.post();
}

void ThreadedPipeline::note_detection(const DetectionEnd& detection) {
  const MasksState now = detection.failed ? MasksState::kFailing : MasksState::kComing;
  if (now == masks_state_) return;
  masks_state_ = now;
  if (detection.failed) {
    events_->say({detection.t_capture_ns, rt::LogLevel::kWarning, "detections fail"});
  } else {
    // Without a pace the times of the pictures are not those of this machine.
    const double age_s = newest_frame_ ? rt::to_seconds(detection.t_done_ns - detection.t_capture_ns) : 0;
    events_->say({detection.t_capture_ns, rt::LogLevel::kInfo, "detections come", "", "after [s]", age_s, 0});
  }
}

void ThreadedPipeline::look_for_silence(rt::TimeNs now_ns) {
  if (!newest_frame_ || now_ns - t_heard_ns_ < kSilenceNs) return;
  if (!silent_) {
    events_->say({now_ns, rt::LogLevel::kWarning, "no picture", "", "for [s]", rt::to_seconds(now_ns - t_heard_ns_),
                  rt::to_seconds(kSilenceNs)});
  }
  silent_ = true;
  if (options_.tap != nullptr) options_.tap->no_picture(now_ns, t_last_capture_ns_);
}

void ThreadedPipeline::look_around() {
  const rt::TimeNs now_ns = rt::monotonic_now_ns();
  look_for_silence(now_ns);
  // No frame takes them; the ring must not overflow.
  take_samples(std::numeric_limits<rt::TimeNs>::max());
  // Without a pace times are the recording's, and only frames tell how late it is there.
  if (newest_frame_) look_for_imu_silence(now_ns);
}

void ThreadedPipeline::note_picture(rt::TimeNs now_ns, rt::TimeNs t_capture_ns) {
  if (silent_) {
    events_->say(
        {now_ns, rt::LogLevel::kInfo, "pictures again", "", "after [s]", rt::to_seconds(now_ns - t_heard_ns_), 0});
  }
  silent_ = false;
  t_heard_ns_ = now_ns;
  t_last_capture_ns_ = t_capture_ns;
}

void ThreadedPipeline::track_one(rt::FrameHandle handle, rt::FrameReturn* tracker_return) {
  const int dropped = newest_frame_ ? take_newest(&handle, tracker_return) : 0;
  take_samples(handle.meta.t_capture_ns);
  look_for_imu_silence(handle.meta.t_capture_ns);
  FrameRecord record;
  if (options_.tap != nullptr) options_.tap->frame_begun();
  track_frame(stage_, handle, &record);
  note_picture(record.t_done_ns, record.t_capture_ns);
  if (options_.tap != nullptr) options_.tap->frame_done(record);
  if (const auto change = state_.changed(record)) events_->say(*change);
  const rt::TimeNs mapper_cpu = mapper_cpu_ns_.load(std::memory_order_relaxed);
  record.mapper_cpu_ns = mapper_cpu - mapper_cpu_seen_;
  record.stage_ns[kMapStage] = record.mapper_cpu_ns;
  mapper_cpu_seen_ = mapper_cpu;
  finish(tracked_.get(), record);
  // Release, partner: the acquire load in collect_one(). See finished_.
  finished_.store(++through_, std::memory_order_release);
  schedule(handle, record, dropped, tracker_return);
}

void ThreadedPipeline::track() {
  rt::FrameReturn tracker_return = pool_->reader(kTrackerReader);
  t_heard_ns_ = rt::monotonic_now_ns();
  const rt::PageFaults before = rt::thread_page_faults();
  {
    const rt::RtScope real_time;
    while (true) {
      // Acquire, partner: the release store in feed(). See feeder_done_.
      const bool last_look = feeder_done_.load(std::memory_order_acquire);
      pulses_[kTracker].beat();
      rt::FrameHandle handle;
      if (!frames_.try_pop(&handle)) {
        if (last_look) break;
        tracker_wake_.wait_for(kSleepNs);
        look_around();
        continue;
      }
      track_one(handle, &tracker_return);
      mapper_backlog_.store(stage_->mapper_backlog(), std::memory_order_relaxed);
      tracked_count_.store(through_, std::memory_order_relaxed);
      mapper_wake_.post();
      feeder_wake_.post();
    }
  }
  faults_[kTracker] = rt::thread_page_faults() - before;
  // Release, partners: the acquire loads in run() and map(). See tracker_done_.
  tracker_done_.store(true, std::memory_order_release);
  for (rt::WakeUp* wake : {&mapper_wake_, &detector_wake_, &collector_wake_}) wake->post();
}

void ThreadedPipeline::map() {
  const rt::PageFaults before = rt::thread_page_faults();
  // What is left when the tracker has ended helps nobody any more.
  while (!tracker_done_.load(std::memory_order_acquire)) {
    pulses_[kMapper].beat();
    const rt::RtScope real_time;
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
  faults_[kMapper] = rt::thread_page_faults() - before;
}

void ThreadedPipeline::detect() {
  rt::FrameReturn detector_return = pool_->reader(kDetectorReader);
  const rt::PageFaults before = rt::thread_page_faults();
  while (!tracker_done_.load(std::memory_order_acquire)) {
    DetectorJob job;
    if (!jobs_.try_pop(&job)) {
      detector_wake_.wait_for(kSleepNs);
      continue;
    }
    // Out of memory, or a library that gives up: there is no mask, and the flight goes on.
    bool found = false;
    guarded([&] { found = options_.detector->detect(job); });
    detector_return.give_back(job.frame.slot);
    // Never full: the scheduler gives no second order before the first has come back.
    const bool pushed = detections_.try_push({rt::monotonic_now_ns(), job.frame.meta.t_capture_ns, !found});
    assert(pushed);
    static_cast<void>(pushed);
  }
  faults_[kDetector] = rt::thread_page_faults() - before;
}

bool ThreadedPipeline::collect_one(FrameRecord* record, bool all_done) {
  // Two ordered streams into one. A tracked frame never waits for the other stream: whatever the feeder put aside
  // before it handed that frame over is visible by now. A picture put aside waits until the frames handed over before
  // it are finished. Acquire, partner: the release stores in track_one() and take_newest(). Read before the rings: see
  // finished_.
  const std::uint64_t finished = finished_.load(std::memory_order_acquire);
  const FrameRecord* tracked = tracked_->front();
  const Fed* fed = fed_->front();
  const bool fed_first = fed != nullptr && (tracked != nullptr ? fed->record.sequence < tracked->sequence
                                                               : all_done || fed->handed_before <= finished);
  if (fed_first) {
    *record = fed->record;
    fed_->drop_front();
    return true;
  }
  if (tracked == nullptr) return false;
  *record = *tracked;
  tracked_->drop_front();
  return true;
}

}  // namespace godwit::app
