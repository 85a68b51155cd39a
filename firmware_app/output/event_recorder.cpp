#include "firmware_app/output/event_recorder.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <cstring>
#include <fmt/format.h>
#include <mutex>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "firmware_app/output/detached_thread.h"
#include "firmware_app/output/event_folder.h"
#include "firmware_app/output/event_ring.h"
#include "firmware_app/output/event_signal.h"
#include "hal/camera/calibration_toml.h"
#include "hal/rt/process_end.h"

namespace godwit::app {
namespace {

constexpr rt::TimeNs kTurnNs = 100 * rt::kNsPerMs;
/// Live: pictures that should have come by now do not come any more.
constexpr rt::TimeNs kOverdueNs = rt::kNsPerSecond;
/// So long a flight that is not live waits for a disc.
constexpr auto kDiscPatience = std::chrono::seconds(60);
/// Not live: pictures that may be copied before it is heard what became of them, or what is kept before an event would
/// be gone when that is told.
constexpr std::uint32_t kAhead = 8;
constexpr rt::TimeNs kCopierPatienceNs = 2 * rt::kNsPerSecond;  // it has a few pictures left
constexpr std::size_t kWaiting = 2;     // events that wait for the disc, and one that is being written
constexpr std::size_t kMostCauses = 8;  // of one event
constexpr double kUsualFps = 30;
constexpr double kSamplesHz = 1000;                   // the fastest sensor
constexpr rt::TimeNs kMarginNs = 100 * rt::kNsPerMs;  // of readings around the pictures
constexpr int kWriterNice = 10;

rt::TimeNs to_ns(double s) {
  return static_cast<rt::TimeNs>(s * 1e9);
}

/// An event from its cause to its folder. Its memory is used again.
struct Job {
  std::vector<EventCause> causes;
  std::uint64_t first = 0, end = 0;  ///< pictures; end: once it is closed
  rt::TimeNs t_close_ns = 0;         ///< capture time of the last picture wanted
  rt::TimeNs overdue_ns = 0;         ///< live: CLOCK_MONOTONIC by which that should have come
  std::vector<hal::ImuSample> samples;
};

}  // namespace

struct EventRecorder::State {
  State(EventRecorderOptions o, rt::FramePool* p, std::unique_ptr<EventRing> r)
      : options(std::move(o)), pool(p), ring(std::move(r)) {
    for (Job& job : jobs) {
      job.causes.reserve(kMostCauses);
      job.samples.reserve(ring->size().samples);
    }
  }

  const EventRecorderOptions options;
  rt::FramePool* const pool;  // the copier's only: gone after finish()
  Onlooker onlooker;
  std::atomic<bool> flight_over{false};  // release: all was shown before; partner: the acquire load in copy()

  mutable std::mutex mutex;
  std::condition_variable change;
  const std::unique_ptr<EventRing> ring;
  /// Jobs by their count, each in its turn at place count % size: [done, closed) wait for the disc, the first of them
  /// perhaps being written; with `open` there is one more.
  std::array<Job, kWaiting + 2> jobs;
  std::uint64_t done = 0, closed = 0, begun = 0;
  std::uint64_t to_write = 0;  // first picture of the event being written that is not on the disc
  std::uint32_t heard = 0;     // not live: number of the newest picture of which frame() has told
  bool open = false, ending = false, abandoned = false, writer_ended = false;
  EventReport report;

  Job& job(std::uint64_t count) { return jobs[count % jobs.size()]; }
  bool idle() const { return done == closed && !open; }

  void copy();
  void keep(const rt::FrameHandle& frame);
  void take_samples();
  void look_for_signal();
  void begin(EventCause cause);
  void close();
  void hold();
  void write_all();
  void say(const std::string& line) const {
    if (options.say) options.say(line);
  }
};

/// Under the lock: which pictures must stay.
void EventRecorder::State::hold() {
  std::uint64_t from = ~0ULL;
  for (std::uint64_t i = done; i < closed + (open ? 1 : 0); ++i) {
    from = std::min(from, i == done && i < closed ? std::max(job(i).first, to_write) : job(i).first);
  }
  ring->keep_from(from);
}

/// Under the lock.
void EventRecorder::State::begin(EventCause cause) {
  if (ending) return;
  if (open) {
    if (job(closed).causes.size() < kMostCauses) job(closed).causes.push_back(std::move(cause));
    return;
  }
  if (begun >= options.most_events || closed - done > kWaiting) {
    if (++report.suppressed == 1) {
      say(fmt::format(
          "event recorder: {} ({}) is not written: {}", event_kind_name(cause.kind), cause.reason,
          begun >= options.most_events ? "this flight has had recorder.events of them" : "others wait for the disc"));
    }
    return;
  }
  ++begun;
  Job& j = job(closed);
  j.causes.clear();
  // Where memory is short, each side has its share of it.
  const double share = options.before_s / (options.before_s + options.after_s);
  const auto most = static_cast<std::uint64_t>(share * static_cast<double>(ring->size().pictures));
  const std::uint64_t nearest = ring->next() > most ? ring->next() - most : 0;
  j.first = ring->at(cause.t_ns - to_ns(options.before_s), nearest);
  j.t_close_ns = cause.t_ns + to_ns(options.after_s);
  j.overdue_ns = rt::monotonic_now_ns() + to_ns(options.after_s) + kOverdueNs;
  j.causes.push_back(std::move(cause));
  open = true;
  hold();
}

/// Under the lock.
void EventRecorder::State::close() {
  if (!open) return;
  Job& j = job(closed);
  j.end = ring->next();
  const bool any = j.first < j.end;
  ring->copy_samples(any ? ring->meta(j.first).t_capture_ns - kMarginNs : 0,
                     any ? ring->meta(j.end - 1).t_capture_ns + kMarginNs : 0, &j.samples);
  open = false;
  if (done == closed) to_write = j.first;
  ++closed;
  hold();
  change.notify_all();
}

void EventRecorder::State::take_samples() {
  hal::ImuSample sample;
  const std::lock_guard<std::mutex> lock(mutex);
  while (onlooker.samples.try_pop(&sample)) ring->add(sample);
}

void EventRecorder::State::keep(const rt::FrameHandle& frame) {
  std::uint8_t* to = nullptr;
  {
    std::unique_lock<std::mutex> lock(mutex);
    if (!options.live) {
      change.wait_for(lock, kDiscPatience, [&] {
        return heard + kAhead >= frame.meta.sequence || flight_over.load(std::memory_order_relaxed);
      });
    }
    if (open && frame.meta.t_capture_ns > job(closed).t_close_ns) close();
    const auto find_place = [&] {
      to = ring->place();
      // An event longer than the memory ends here.
      if (to == nullptr && open && done == closed) close();
      return to != nullptr || writer_ended;
    };
    find_place();
    if (to == nullptr && !options.live) change.wait_for(lock, kDiscPatience, find_place);
    if (to == nullptr) {
      ++report.pictures_missed;
      return;
    }
  }
  // The place is ours until added().
  const rt::ImageView grey = pool->grey(frame.slot);
  for (int y = 0; y < grey.height; ++y) {
    const std::size_t width = grey.width;
    std::memcpy(to + y * width, grey.row(y), width);
  }
  const std::lock_guard<std::mutex> lock(mutex);
  ring->added(frame.meta);
}

void EventRecorder::State::look_for_signal() {
  if (!options.by_signal || !take_event_signal()) return;
  const std::lock_guard<std::mutex> lock(mutex);
  const rt::TimeNs t_ns =
      ring->next() > ring->first() ? ring->meta(ring->next() - 1).t_capture_ns : rt::monotonic_now_ns();
  begin({EventKind::kRequest, t_ns, "asked for by SIGUSR1"});
}

void EventRecorder::State::copy() {
  rt::FrameReturn back = pool->onlooker();
  while (true) {
    const bool last = flight_over.load(std::memory_order_acquire);
    take_samples();
    // Given back before it leaves the ring: no more slots are ours than it has places.
    while (const rt::FrameHandle* frame = onlooker.pictures.front()) {
      keep(*frame);
      back.give_back(frame->slot);
      onlooker.pictures.drop_front();
      take_samples();
    }
    if (last) break;
    look_for_signal();
    {
      const std::lock_guard<std::mutex> lock(mutex);
      if (open && options.live && rt::monotonic_now_ns() > job(closed).overdue_ns) close();
    }
    onlooker.wake.wait_for(kTurnNs);
  }
  const std::lock_guard<std::mutex> lock(mutex);
  close();
  ending = true;
  change.notify_all();
}

void EventRecorder::State::write_all() {
  setpriority(PRIO_PROCESS, static_cast<id_t>(syscall(SYS_gettid)), kWriterNice);
  EventFolders folders({options.folder, options.budget_bytes, options.room,
                        hal::calibration_yaml(options.calibration,
                                              "# As it was flown; the pictures are the grey ones that were tracked.\n"),
                        options.info});
  const EventRing& held = *ring;
  std::unique_lock<std::mutex> lock(mutex);
  while (true) {
    change.wait(lock, [this] { return abandoned || ending || done < closed; });
    if (abandoned || done == closed) break;
    Job& j = job(done);  // nobody else touches it until it is done
    to_write = j.first;
    lock.unlock();
    const EventFolders::Event event{j.causes, j.first, j.end,
                                    (j.end - j.first) * static_cast<std::uint64_t>(held.size().width) *
                                        static_cast<std::uint64_t>(held.size().height),
                                    &j.samples};
    rt::Result<std::string> written = rt::Error{"out of memory"};
    try {
      written = folders.write(
          event,
          [&held](std::uint64_t n) {
            return std::pair{held.meta(n), held.pixels(n)};
          },
          [this](std::uint64_t n) {
            const std::lock_guard<std::mutex> inner(mutex);
            to_write = n + 1;
            hold();
            change.notify_all();
            return !abandoned;
          });
    } catch (const std::exception& e) {
      written = rt::Error{e.what()};
    }
    const std::string about = fmt::format("{} ({})", event_kind_name(j.causes.front().kind), j.causes.front().reason);
    say(written.ok() ? fmt::format("event: {}: {} pictures in {}", about, j.end - j.first, written.value())
                     : fmt::format("warning: event: {} is not written: {}", about, written.error().message));
    lock.lock();
    if (written.ok()) {
      ++report.written;
    } else {
      ++report.failed;
      report.trouble = written.error().message;
    }
    ++done;
    if (done < closed) to_write = job(done).first;
    hold();
    change.notify_all();
  }
  writer_ended = true;
  change.notify_all();
}

EventRecorder::EventRecorder(std::shared_ptr<State> state) : state_(std::move(state)) {}

rt::Result<std::unique_ptr<EventRecorder>> EventRecorder::start(EventRecorderOptions options, rt::FramePool* pool) {
  const hal::CameraCalibration& c = options.calibration;
  const double seconds = options.before_s + options.after_s + 1;
  const std::size_t wanted = static_cast<std::size_t>(std::ceil(seconds * (c.fps > 0 ? c.fps : kUsualFps)));
  const std::size_t one = pool->layout().width * pool->layout().height;
  const std::size_t affordable = options.memory_bytes / one;
  if (affordable < 2) {
    return rt::Error{fmt::format("event recorder: recorder.memory_mb holds {} pictures of {} x {}", affordable,
                                 pool->layout().width, pool->layout().height)};
  }
  options.calibration.channels = 1;
  auto ring = EventRing::create({pool->layout().width, pool->layout().height, std::min(wanted, affordable),
                                 static_cast<std::size_t>(seconds * kSamplesHz)});
  if (!ring) return rt::Error{"event recorder: " + ring.error().message};
  auto state = std::make_shared<State>(std::move(options), pool, std::move(ring).value());
  std::unique_ptr<EventRecorder> out(new EventRecorder(state));
  if (auto r = out->copier_.start("gw-events", {}, [state] { state->copy(); }); !r) {
    state->writer_ended = true;
    return r.error();
  }
  // With a share of the state: a disc that hangs keeps no end away.
  if (!start_detached("gw-eventwrite", [state] { state->write_all(); })) {
    state->writer_ended = true;
    return rt::Error{"event recorder: no thread to be had"};
  }
  return out;
}

EventRecorder::~EventRecorder() {
  finish(0);
}

Onlooker* EventRecorder::onlooker() {
  return &state_->onlooker;
}

std::string EventRecorder::description() const {
  const EventRing::Size& size = state_->ring->size();
  const double fps = state_->options.calibration.fps > 0 ? state_->options.calibration.fps : kUsualFps;
  const double wanted = state_->options.before_s + state_->options.after_s;
  const double kept = std::min(wanted, static_cast<double>(size.pictures) / fps);
  std::string out = fmt::format("keeps {:.1f} s of {} x {} pictures at {:.0f} Hz in {:.0f} MB", kept, size.width,
                                size.height, fps, static_cast<double>(size.bytes()) * 1e-6);
  if (kept < wanted) out += fmt::format("; {:.1f} s are wanted, recorder.memory_mb does not hold more", wanted);
  return out;
}

void EventRecorder::frame(const FrameRecord& record) noexcept {
  try {
    auto cause = causes_.look(record);
    if (!cause && state_->options.live) return;
    const std::lock_guard<std::mutex> lock(state_->mutex);
    state_->heard = std::max(state_->heard, record.sequence);
    if (!state_->options.live) state_->change.notify_all();
    if (!cause) return;
    state_->begin(std::move(*cause));
  } catch (const std::exception&) {
  }
}

void EventRecorder::request(const std::string& who) noexcept {
  try {
    const std::lock_guard<std::mutex> lock(state_->mutex);
    const EventRing& ring = *state_->ring;
    const rt::TimeNs t_ns =
        ring.next() > ring.first() ? ring.meta(ring.next() - 1).t_capture_ns : rt::monotonic_now_ns();
    state_->begin({EventKind::kRequest, t_ns, "asked for by " + who});
  } catch (const std::exception&) {
  }
}

EventReport EventRecorder::finish(rt::TimeNs patience_ns) noexcept {
  try {
    {
      const std::lock_guard<std::mutex> lock(state_->mutex);
      state_->flight_over.store(true, std::memory_order_release);
      state_->change.notify_all();
    }
    state_->onlooker.wake.post();
    rt::join_in_time(&copier_, kCopierPatienceNs, state_->options.abandon);
    std::unique_lock<std::mutex> lock(state_->mutex);
    state_->change.wait_for(lock, std::chrono::nanoseconds(rt::patience_left_ns(patience_ns)),
                            [this] { return state_->writer_ended; });
    if (!state_->writer_ended && !state_->abandoned) {
      state_->abandoned = true;
      state_->report.failed += state_->closed - state_->done;
      state_->report.trouble = "the flight's end did not wait for the disc";
      state_->change.notify_all();
    }
  } catch (const std::exception&) {
  }
  return report();
}

EventReport EventRecorder::report() const noexcept {
  try {
    const std::lock_guard<std::mutex> lock(state_->mutex);
    EventReport out = state_->report;
    out.pictures_missed += state_->onlooker.pictures_missed.load(std::memory_order_relaxed);
    out.samples_missed += state_->onlooker.samples_missed.load(std::memory_order_relaxed);
    return out;
  } catch (const std::exception&) {
    return {};
  }
}

}  // namespace godwit::app
