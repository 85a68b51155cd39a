// Armed: camera, IMU, tracker, mapper and link threads under traps for heap and locks, the event recorder and somebody
// who looks on beside them; page faults and memory watched.
// One minute; or, as root, with the figures of README.md,
//   GODWIT_ARMED_FRAMES=10000 [GODWIT_ARMED_LOAD=1] build/release/tests/realtime/armed_test --gtest_filter='Armed.No*'
// LOAD: a program that computes without end on the last processor. 18000 frames are ten minutes.
#include <algorithm>
#include <atomic>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <mutex>
#include <sys/mman.h>
#include <thread>
#include <unistd.h>

#include "firmware_app/autopilot/link_runner.h"
#include "firmware_app/flight/pipeline_plan.h"
#include "firmware_app/output/event_recorder.h"
#include "firmware_app/output/live_picture.h"
#include "hal/rt/alloc_hook.h"
#include "hal/rt/lock_hook.h"
#include "hal/rt/rt_scope.h"
#include "tests/realtime/flown.h"
#include "tests/support/temp_folder.h"

namespace godwit::app::armed_test {
namespace {

using testing::HasSubstr;

void set_traps(bool on) {
  rt::trap_heap_use(on);
  rt::trap_lock_use(on);
}

/// Computes on memory larger than a core's cache, as a network does, on the last processor.
class Load {
 public:
  explicit Load(bool on) {
    if (!on) return;
    thread_ = std::thread([this] {
      rt::apply_plan(pthread_self(), "load", {{static_cast<int>(sysconf(_SC_NPROCESSORS_ONLN)) - 1}, 0});
      std::vector<float> a(2'000'000, 1.0F);
      while (!stop_.load(std::memory_order_relaxed)) {
        for (float& v : a) v = v * 0.999F + 0.001F;
      }
    });
  }
  ~Load() {
    stop_.store(true);
    if (thread_.joinable()) thread_.join();
  }

 private:
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

/// Somebody who looks at the flight: asks for a picture five times a second, as godwitd's socket does.
class Looker {
 public:
  explicit Looker(LivePicture* picture) : picture_(picture) {
    line_.assign(1'000'000, ' ');  // before the flight's memory is measured
    thread_ = std::thread([this] {
      while (!stop_.load(std::memory_order_relaxed)) {
        line_.clear();
        if (picture_->add_line(rt::monotonic_now_ns(), &line_)) seen.fetch_add(1, std::memory_order_relaxed);
        rt::sleep_until_ns(rt::monotonic_now_ns() + rt::kNsPerSecond / 5);
      }
    });
  }
  ~Looker() {
    stop_.store(true);
    thread_.join();
  }
  std::atomic<int> seen{0};

 private:
  LivePicture* const picture_;
  std::string line_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

double percentile(std::vector<double> values, double p) {
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(p * static_cast<double>(values.size() - 1))];
}

/// Asks for an event in the middle of the flight.
class Asking final : public test::Notes {
 public:
  Asking(std::size_t frames, EventRecorder* recorder) : Notes(frames), frames_(frames), recorder_(recorder) {}
  rt::Result<void> take(const FrameRecord& record) override {
    recorder_->frame(record);
    if (records.size() == frames_ / 8) resident_kb = test::resident_kb();
    if (records.size() == frames_ * 7 / 8) resident_later_kb = test::resident_kb();
    if (records.size() == frames_ / 2) recorder_->request("the test");
    return Notes::take(record);
  }
  long resident_kb = 0;        ///< once the flight has made all that it begins with
  long resident_later_kb = 0;  ///< towards its end, while all its threads run

 private:
  const std::size_t frames_;
  EventRecorder* const recorder_;
};

TEST(Armed, NoHeapNoLockNoPageFaultOnCameraTrackerAndLink) {
  const int frames = test::from_environment("GODWIT_ARMED_FRAMES", 1800);
  const int fps = test::from_environment("GODWIT_ARMED_FPS", 30);
  const bool loaded = test::from_environment("GODWIT_ARMED_LOAD", 0) != 0;
  LoopedPictures::Options camera_options;
  camera_options.interval_ns = rt::kNsPerSecond / fps;
  camera_options.total = frames;
  const auto camera = test::camera_of(camera_options);
  test::RestingImu imu;
  LivePicture picture(test::world().calibration.width, test::world().calibration.height);
  test::Odometry odometry(false, false, true, &picture);
  // As the daemon flies it: copying all the time, and writing once.
  const test::TempFolder events;
  EventRecorderOptions recorder_options;
  recorder_options.folder = events / "events";
  recorder_options.calibration = test::world().calibration;
  recorder_options.by_signal = false;
  auto recorder = EventRecorder::start(recorder_options, odometry.pool.get());
  ASSERT_TRUE(recorder.ok()) << recorder.error().message;
  Asking notes(static_cast<std::size_t>(frames), recorder.value().get());

  Config config;
  config.threads.lock_memory = true;
  config.threads.imu.priority = 65;
  config.threads.camera.priority = 60;
  config.threads.tracker.priority = 50;
  config.threads.mapper.priority = 10;
  if (loaded)
    config.threads.imu.cpus = config.threads.camera.cpus = config.threads.tracker.cpus =
        config.threads.mapper.cpus = {0};
  PipelineOptions options;
  options.newest_frame = true;
  options.imu = &imu;
  options.onlooker = recorder.value()->onlooker();
  plan_pipeline(config, fps, &options);
  const Load load(loaded);
  const Looker looker(&picture);

  // The link as the daemon flies it: gw-link under the same rules, its keeper as any thread.
  rt::Heartbeats heartbeats;
  LinkRunnerOptions link_options;
  link_options.settings.can = "multicast:7:127.0.0.1";
  link_options.settings.link.odometry.bench_metric = true;  // so that poses count, and velocities are fitted
  // Two nodes of one id on the bus, which tests share, would be an error.
  link_options.settings.link.parameters[static_cast<std::size_t>(link::Parameter::kNodeId)] = 20 + getpid() % 100;
  link_options.settings.link.identity.unique_id = {1, 2, 4};
  link_options.settings.link.heartbeats = link_options.heartbeats = options.heartbeats = &heartbeats;
  link_options.thread.priority = geteuid() == 0 ? 40 : 0;

  const std::atomic<bool> stop{false};
  const std::string refused = arm_memory(config);
  auto started = LinkRunner::start(link_options, stop);
  ASSERT_TRUE(started.ok()) << started.error().message;
  LinkRunner* const link = started.value().get();
  options.tap = link;
  set_traps(true);
  const auto run = run_pipeline(camera.get(), odometry.stage.get(), odometry.pool.get(), options, &notes, stop);
  const link::LinkStatus told = link->finish();
  set_traps(false);
  munlockall();

  ASSERT_TRUE(run.ok()) << run.error().message;
  const EventReport written = recorder.value()->finish(60 * rt::kNsPerSecond);
  EXPECT_GE(written.written, 1u) << written.trouble;
  PipelineCounters c = run.value();
  c.threads.push_back(link->thread_report());
  EXPECT_EQ(c.due, static_cast<std::uint64_t>(frames));
  int tracked = 0;
  std::vector<double> ages, tracker;
  for (const FrameRecord& r : notes.records) {
    tracked += r.tracked ? 1 : 0;
    if (!r.tracked) continue;
    ages.push_back(rt::to_ms(r.t_done_ns - r.t_capture_ns));
    tracker.push_back(rt::to_ms(r.wall_ns));
  }
  EXPECT_GT(c.imu->samples, static_cast<std::uint64_t>(frames));
  EXPECT_GT(looker.seen, frames / fps) << "somebody looked on all the time";
  EXPECT_GT(tracked, frames / 2) << "what is not flown proves nothing";
  EXPECT_GT(told.odometry_sent, static_cast<std::uint64_t>(frames) / 2) << "they went out to the bus";
  EXPECT_GT(told.bus.sent, told.odometry_sent);
  // The traps would have ended the program: heap and locks are proven by our being here.
  if (refused.empty()) {
    for (const ThreadReport& t : c.threads) {
      if (t.name == std::string("mapper")) continue;  // bounded, but not under this rule
      EXPECT_EQ(t.faults.minor, 0) << t.name;
      EXPECT_EQ(t.faults.major, 0) << t.name;
    }
  } else {
    std::printf("page faults are NOT held against it, memory cannot be locked here: %s\n", refused.c_str());
  }
  for (const ThreadReport& t : c.threads) EXPECT_LT(t.stack_used, rt::kThreadStackBytes * 3 / 4) << t.name;
  // An event that is written takes a picture's size and libpng's workspace, once.
  ASSERT_GT(notes.resident_kb, 0);
  EXPECT_LT(notes.resident_later_kb - notes.resident_kb, 1024 + 768) << "[kB] memory is constant in flight";

  std::printf(
      "%d frames at %d a second%s: %d tracked, %llu late, %llu dropped; capture to pose median %.2f ms, p99 %.2f, "
      "max %.2f; tracker median %.2f, p99 %.2f, max %.2f\n",
      frames, fps, loaded ? " beside a load" : "", tracked, static_cast<unsigned long long>(c.scheduler.slips),
      static_cast<unsigned long long>(c.dropped_late + c.dropped_slots), percentile(ages, 0.5), percentile(ages, 0.99),
      percentile(ages, 1), percentile(tracker, 0.5), percentile(tracker, 0.99), percentile(tracker, 1));
  for (const ThreadReport& t : c.threads) {
    std::printf("thread %s: %lld minor, %lld major faults, %zu kB of stack\n", t.name,
                static_cast<long long>(t.faults.minor), static_cast<long long>(t.faults.major), t.stack_used / 1024);
  }
  std::printf("%llu ODOMETRY sent\nmemory grew by %ld kB to %ld kB\n",
              static_cast<unsigned long long>(told.odometry_sent), notes.resident_later_kb - notes.resident_kb,
              notes.resident_later_kb);
}

/// Ends the flight after so many records.
class Ending final : public test::Notes {
 public:
  explicit Ending(std::size_t frames) : Notes(frames), frames_(frames) {}
  rt::Result<void> take(const FrameRecord& record) override {
    stop.store(records.size() + 1 >= frames_);
    return Notes::take(record);
  }
  std::atomic<bool> stop{false};

 private:
  const std::size_t frames_;
};

// The flight with its own sensor's readings, one thread: in it readings, alignment and smoother are under the traps.
TEST(Armed, NoHeapNoLockWhereTheInertialSensorIsUsed) {
  const auto camera = test::world().flight->camera(0);
  const auto imu = test::world().flight->imu(0);
  test::Odometry odometry(false, true);
  PipelineOptions options;
  options.sequential = true;
  options.imu = imu.get();
  Ending notes(100);
  set_traps(true);
  const auto run = run_pipeline(camera.get(), odometry.stage.get(), odometry.pool.get(), options, &notes, notes.stop);
  set_traps(false);
  ASSERT_TRUE(run.ok()) << run.error().message;
  int metric = 0;
  for (const FrameRecord& r : notes.records) metric += r.metric ? 1 : 0;
  EXPECT_GT(metric, 10) << "what was never solved proves nothing";
}

/// Tracks nothing and misbehaves on each frame.
class Offender final : public FrameStage {
 public:
  enum class Offence { kHeap, kLock, kPages };
  Offender(rt::FramePool* pool, Offence offence) : return_(pool->reader(kTrackerReader)), offence_(offence) {}
  void track(const rt::FrameHandle& frame, FrameRecord* record) override {
    record->state = vo::State::kLost;
    if (offence_ == Offence::kHeap) kept_ = std::make_unique<int>(3);
    if (offence_ == Offence::kLock) const std::lock_guard<std::mutex> held(mutex_);
    if (offence_ == Offence::kPages) {
      constexpr std::size_t kBytes = 4 * 4096;
      void* const page = mmap(nullptr, kBytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
      for (std::size_t i = 0; i < kBytes; i += 4096) static_cast<volatile char*>(page)[i] = 1;
      munmap(page, kBytes);
    }
    return_.give_back(frame.slot, kFrameReaders);
  }
  int mapper_backlog() const override { return 0; }
  bool map_step() override { return false; }

 private:
  rt::FrameReturn return_;
  const Offence offence_;
  std::mutex mutex_;
  std::unique_ptr<int> kept_;
};

/// A grey camera of few pixels; real-time, so its thread is marked too.
class PlainCamera final : public hal::Camera {
 public:
  explicit PlainCamera(bool offends) : offends_(offends) {}
  int width() const override { return 64; }
  int height() const override { return 64; }
  int channels() const override { return 1; }
  bool real_time() const override { return true; }
  hal::CameraStatus next(const rt::MutableImageView&, std::uint8_t*, rt::TimeNs, hal::CapturedFrame* frame,
                         std::string*) override {
    if (sequence_ == 20) return hal::CameraStatus::kEnd;
    if (offends_) kept_ = std::make_unique<int>(4);
    frame->sequence = sequence_++;
    frame->t_capture_ns = frame->sequence * rt::kNsPerMs + rt::kNsPerSecond;
    return hal::CameraStatus::kFrame;
  }

 private:
  const bool offends_;
  std::uint32_t sequence_ = 0;
  std::unique_ptr<int> kept_;
};

PipelineCounters fly_offence(Offender::Offence offence, bool camera_offends) {
  rt::FramePool::Layout layout;
  layout.width = layout.height = 64;
  layout.slots = 8;
  layout.readers = kFrameReaders;
  const auto pool = std::move(rt::FramePool::create(layout)).value();
  Offender stage(pool.get(), offence);
  PlainCamera camera(camera_offends);
  test::Notes notes(20);
  const std::atomic<bool> stop{false};
  auto run = run_pipeline(&camera, &stage, pool.get(), {}, &notes, stop);
  return run.ok() ? run.value() : PipelineCounters{};
}

TEST(ArmedDeathTest, ATrackerThatAllocatesIsCaught) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_DEATH((set_traps(true), fly_offence(Offender::Offence::kHeap, false)),
               "memory was allocated on a real-time thread");
}

TEST(ArmedDeathTest, ATrackerThatLocksIsCaught) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_DEATH((set_traps(true), fly_offence(Offender::Offence::kLock, false)),
               "a mutex, condition or lock was used on a real-time thread");
}

TEST(ArmedDeathTest, ACameraThatAllocatesIsCaught) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_DEATH((set_traps(true), fly_offence(Offender::Offence::kPages, true)),
               "memory was allocated on a real-time thread");
}

TEST(Armed, ATrackerThatFaultsPagesIsCounted) {
  const PipelineCounters c = fly_offence(Offender::Offence::kPages, false);
  ASSERT_EQ(c.threads.size(), 3u);
  EXPECT_STREQ(c.threads[1].name, "tracker");
  EXPECT_GE(c.threads[1].faults.minor, 20) << "a page or more each frame";
}

}  // namespace
}  // namespace godwit::app::armed_test
