// The recorder behind a pipeline of fakes: what it keeps, what it writes, what a disc that hangs or refuses costs.
#include "firmware_app/output/event_recorder.h"

#include <filesystem>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <mutex>

#include "hal/camera/replay/replay_camera.h"
#include "hal/imu/replay/imu_record.h"
#include "tests/app/fake_pipeline.h"
#include "tests/support/standing_thread.h"
#include "tests/support/temp_folder.h"

namespace godwit::app {
namespace {
namespace fs = std::filesystem;
using testing::HasSubstr;

/// 200 readings a second, without a pace, between the pictures of a camera that takes 20.
class Readings final : public hal::Imu {
 public:
  double rate_hz() const override { return 200; }
  hal::ImuStatus next(hal::ImuSample* s, rt::TimeNs) override {
    *s = {};
    s->t_ns = rt::kNsPerSecond + number_++ * 5 * rt::kNsPerMs;
    return hal::ImuStatus::kSample;
  }

 private:
  rt::TimeNs number_ = 0;
};

/// Passes records on, and changes what is wanted of them.
class Passing final : public FrameSink {
 public:
  explicit Passing(EventRecorder* recorder) : recorder_(recorder) {}
  std::set<std::uint32_t> lost;     ///< frames of which tracking is lost
  std::set<std::uint32_t> request;  ///< frames at which somebody asks
  rt::Result<void> take(const FrameRecord& record) override {
    FrameRecord r = record;
    r.state = lost.count(r.sequence) != 0 ? vo::State::kRelocalising : vo::State::kTracking;
    recorder_->frame(r);
    if (request.count(r.sequence) != 0) recorder_->request("a test");
    return {};
  }

 private:
  EventRecorder* const recorder_;
};

std::unique_ptr<rt::FramePool> watched_pool(int slots = 16) {
  rt::FramePool::Layout layout;
  layout.width = kWidth;
  layout.height = kHeight;
  layout.slots = slots;
  layout.readers = kFrameReaders;
  layout.onlooker = true;
  return std::move(rt::FramePool::create(layout)).value();
}

/// A flight of 20 pictures a second, nobody late.
struct Flight {
  explicit Flight(std::uint32_t frames) : camera(frames), pool(watched_pool()), stage(pool.get()) {
    camera.step_ns = 50 * rt::kNsPerMs;
    recorder_options.live = false;
    recorder_options.by_signal = false;
    recorder_options.before_s = 2;
    recorder_options.after_s = 1;
    recorder_options.calibration.width = kWidth;
    recorder_options.calibration.height = kHeight;
    recorder_options.calibration.fx = recorder_options.calibration.fy = 50;
    recorder_options.calibration.cx = recorder_options.calibration.cy = 32;
    recorder_options.calibration.fps = 20;
    recorder_options.say = [this](const std::string& line) {
      const std::lock_guard<std::mutex> lock(mutex);
      said += line + "\n";
    };
  }
  void start() {
    auto started = EventRecorder::start(recorder_options, pool.get());
    ASSERT_TRUE(started.ok()) << started.error().message;
    recorder = std::move(started).value();
    sink = std::make_unique<Passing>(recorder.get());
    options.onlooker = recorder->onlooker();
  }
  PipelineCounters go() {
    const auto run = run_pipeline(&camera, &stage, pool.get(), options, sink.get(), stop);
    EXPECT_TRUE(run.ok());
    return run.ok() ? run.value() : PipelineCounters{};
  }
  std::mutex mutex;
  std::string said;
  FakeCamera camera;
  std::unique_ptr<rt::FramePool> pool;
  FakeStage stage;
  Readings imu;
  EventRecorderOptions recorder_options;
  std::unique_ptr<EventRecorder> recorder;
  std::unique_ptr<Passing> sink;
  PipelineOptions options;
  std::atomic<bool> stop{false};
};

/// Numbers of the pictures of an event, which stand in their pixels.
std::vector<int> pictures(const std::string& folder) {
  auto replay = hal::ReplayCamera::open(folder, {});
  EXPECT_TRUE(replay.ok()) << replay.error().message;
  std::vector<int> out;
  std::vector<std::uint8_t> pixels(static_cast<std::size_t>(kWidth) * kHeight);
  hal::CapturedFrame frame;
  while (replay.ok() && replay.value()->next({pixels.data(), kWidth, kHeight, kWidth}, nullptr, 0, &frame, nullptr) ==
                            hal::CameraStatus::kFrame) {
    out.push_back(pixels[0]);
  }
  return out;
}

void expect_from_to(const std::vector<int>& numbers, int first, int last) {
  ASSERT_EQ(numbers.size(), static_cast<std::size_t>(last - first + 1));
  for (std::size_t i = 0; i < numbers.size(); ++i) EXPECT_EQ(numbers[i], first + static_cast<int>(i));
}

TEST(EventRecorder, ALossLeavesTheSecondsAroundItWithTheirReadings) {
  const test::TempFolder folder;
  for (const bool sequential : {true, false}) {
    Flight f(200);
    f.recorder_options.folder = folder / (sequential ? "one" : "threads");
    f.options.sequential = sequential;
    f.options.imu = &f.imu;
    f.start();
    f.sink->lost = {100};
    EXPECT_EQ(f.go().due, 200u);
    const EventReport report = f.recorder->finish(60 * rt::kNsPerSecond);
    EXPECT_EQ(report.written, 1u) << f.said;
    EXPECT_EQ(report.failed + report.suppressed + report.pictures_missed + report.samples_missed, 0u) << f.said;
    const std::string event = f.recorder_options.folder + "/000001-loss";
    const std::vector<int> numbers = pictures(event);
    // Two seconds before the picture at 100, one after; the loss is told when some more may have been copied.
    ASSERT_FALSE(numbers.empty());
    EXPECT_LE(numbers.front(), 75);
    EXPECT_GE(numbers.front(), 60);
    EXPECT_GE(numbers.back(), 120);
    expect_from_to(numbers, numbers.front(), numbers.back());
    const auto record = hal::read_imu_record(event);
    ASSERT_TRUE(record.ok()) << record.error().message;
    EXPECT_LE(record.value().samples.front().t_ns, rt::kNsPerSecond + numbers.front() * 50 * rt::kNsPerMs);
    EXPECT_GE(record.value().samples.back().t_ns, rt::kNsPerSecond + numbers.back() * 50 * rt::kNsPerMs);
    EXPECT_THAT(test::read_file(event + "/event.json"), HasSubstr("TRACKING -> RELOCALISING"));
    EXPECT_THAT(f.said, HasSubstr("pictures in " + event));
  }
}

TEST(EventRecorder, WhatComesWithinAnEventBelongsToIt) {
  const test::TempFolder folder;
  Flight f(150);
  f.recorder_options.folder = folder / "events";
  f.options.sequential = true;
  f.start();
  f.sink->lost = {100};
  f.sink->request = {105};
  f.go();
  EXPECT_EQ(f.recorder->finish(60 * rt::kNsPerSecond).written, 1u) << f.said;
  EXPECT_THAT(test::read_file(folder / "events/000001-loss/event.json"), HasSubstr("asked for by a test"));
}

TEST(EventRecorder, EventsThatOverlapAreBothWhole) {
  const test::TempFolder folder;
  Flight f(250);
  f.recorder_options.folder = folder / "events";
  f.options.sequential = true;
  f.start();
  f.sink->request = {100, 130, 160};
  f.go();
  EXPECT_EQ(f.recorder->finish(60 * rt::kNsPerSecond).written, 3u) << f.said;
  for (int i = 1; i <= 3; ++i) {
    const std::vector<int> numbers = pictures(folder / "events/00000" + std::to_string(i) + "-request");
    ASSERT_GE(numbers.size(), 60u);
    // The newest picture that was copied is where somebody asks.
    EXPECT_GE(numbers.back(), 120 + 30 * (i - 1) - kOnlookerSlots);
    expect_from_to(numbers, numbers.front(), numbers.back());
  }
}

TEST(EventRecorder, TheFlightsEndCutsTheEventShort) {
  const test::TempFolder folder;
  Flight f(105);
  f.recorder_options.folder = folder / "events";
  f.options.sequential = true;
  f.start();
  f.sink->lost = {100};
  f.go();
  EXPECT_EQ(f.recorder->finish(60 * rt::kNsPerSecond).written, 1u);
  EXPECT_EQ(pictures(folder / "events/000001-loss").back(), 104);
}

TEST(EventRecorder, SoManyEventsAFlightAndNoMore) {
  const test::TempFolder folder;
  Flight f(250);
  f.recorder_options.folder = folder / "events";
  f.recorder_options.most_events = 2;
  f.options.sequential = true;
  f.start();
  f.sink->request = {40, 80, 120, 160};
  f.go();
  const EventReport report = f.recorder->finish(60 * rt::kNsPerSecond);
  EXPECT_EQ(report.written, 2u);
  EXPECT_EQ(report.suppressed, 2u);
  EXPECT_THAT(f.said, HasSubstr("this flight has had recorder.events of them"));
}

TEST(EventRecorder, MemoryThatHoldsLessKeepsFewerPictures) {
  const test::TempFolder folder;
  Flight f(200);
  f.recorder_options.folder = folder / "events";
  f.recorder_options.memory_bytes = 30 * kWidth * kHeight;
  f.options.sequential = true;
  f.start();
  EXPECT_THAT(f.recorder->description(), HasSubstr("keeps 1.5 s"));
  EXPECT_THAT(f.recorder->description(), HasSubstr("recorder.memory_mb does not hold more"));
  f.sink->request = {100};
  f.go();
  EXPECT_EQ(f.recorder->finish(60 * rt::kNsPerSecond).written, 1u) << f.said;
  const std::vector<int> numbers = pictures(folder / "events/000001-request");
  EXPECT_LE(numbers.size(), 30u);
  EXPECT_GE(numbers.size(), 20u);
  EXPECT_LE(numbers.front(), 90);
  EXPECT_GE(numbers.back(), 105);
  f.recorder.reset();
  f.recorder_options.memory_bytes = kWidth * kHeight;
  EXPECT_FALSE(EventRecorder::start(f.recorder_options, f.pool.get()).ok());
}

TEST(EventRecorder, ADiscThatRefusesCostsTheEventAlone) {
  Flight f(200);
  f.recorder_options.folder = "/proc/no/such";
  f.options.sequential = false;
  f.start();
  f.sink->lost = {100};
  EXPECT_EQ(f.go().processed, 200u);
  const EventReport report = f.recorder->finish(60 * rt::kNsPerSecond);
  EXPECT_EQ(report.written, 0u);
  EXPECT_EQ(report.failed, 1u);
  EXPECT_THAT(report.trouble, HasSubstr("cannot be made"));
  EXPECT_THAT(f.said, HasSubstr("is not written: /proc/no/such"));
}

TEST(EventRecorder, AtRealPaceNobodyWaitsForTheRecorder) {
  const test::TempFolder folder;
  Flight f(200);
  f.recorder_options.folder = folder / "events";
  f.recorder_options.live = true;
  f.recorder_options.before_s = 0.5;
  f.recorder_options.after_s = 0.3;
  f.recorder_options.memory_bytes = 40 * kWidth * kHeight;  // hardly more than an event: the disc must keep up
  f.camera.period_ns = 5 * rt::kNsPerMs;
  f.camera.step_ns = 0;
  f.options.newest_frame = true;
  f.start();
  f.sink->request = {60, 130};
  const PipelineCounters c = f.go();
  EXPECT_EQ(c.due, 200u);
  EXPECT_EQ(c.dropped_slots, 0u) << "what the recorder does not take in time it misses, and the flight does not";
  const EventReport report = f.recorder->finish(60 * rt::kNsPerSecond);
  EXPECT_GE(report.written, 1u) << f.said;
}

TEST(EventRecorder, LiveAnEventEndsWhereThePicturesDo) {
  const test::TempFolder folder;
  const auto pool = watched_pool();
  Flight f(1);
  f.recorder_options.folder = folder / "events";
  f.recorder_options.live = true;
  f.recorder_options.after_s = 0.2;
  f.start();
  EventRecorder* const recorder = f.recorder.get();
  const int slot = f.pool->acquire();
  f.pool->meta(slot).t_capture_ns = rt::monotonic_now_ns();
  f.pool->hand_out(slot, 1);
  ASSERT_TRUE(recorder->onlooker()->has_room(true));
  recorder->onlooker()->show({slot, f.pool->meta(slot)});
  rt::sleep_until_ns(rt::monotonic_now_ns() + 300 * rt::kNsPerMs);
  recorder->request("a test");
  for (int i = 0; i < 600 && recorder->report().written == 0; ++i) {
    rt::sleep_until_ns(rt::monotonic_now_ns() + 100 * rt::kNsPerMs);
  }
  EXPECT_EQ(recorder->report().written, 1u) << f.said;
  EXPECT_GE(f.pool->acquire(), 0);
}

TEST(EventRecorder, ACopierThatHangsIsNamedAndKeepsNoEndAway) {
  Flight f(10);
  std::string abandoned;
  f.recorder_options.abandon = [&](const char* thread) {
    abandoned = thread;  // a program would end here
    test::let_thread_go();
  };
  f.start();
  // A thread gets its name before it begins.
  rt::sleep_until_ns(rt::monotonic_now_ns() + 200 * rt::kNsPerMs);
  test::stop_thread("gw-events");
  rt::sleep_until_ns(rt::monotonic_now_ns() + 200 * rt::kNsPerMs);
  f.recorder->finish(rt::kNsPerSecond);
  EXPECT_EQ(abandoned, "gw-events");
}

}  // namespace
}  // namespace godwit::app
