// Threads of the pipeline that hang or throw: nothing of it ends a flight or keeps its end away.
#include <algorithm>
#include <atomic>
#include <functional>
#include <gtest/gtest.h>
#include <new>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "firmware_app/pipeline/pipeline.h"
#include "hal/rt/process_end.h"
#include "hal/rt/wake_up.h"

namespace godwit::app::pipeline_faults_test {
namespace {

constexpr int kWidth = 64, kHeight = 64;

void nap(rt::TimeNs ns) {
  rt::sleep_until_ns(rt::monotonic_now_ns() + ns);
}

/// A place where a thread hangs, until it is let go.
class Trap {
 public:
  void pass() const {
    while (set.load()) nap(rt::kNsPerMs);
  }
  void free() { set.store(false); }
  std::atomic<bool> set{false};
};

class Camera final : public hal::Camera {
 public:
  Trap trap;
  rt::TimeNs age_ns = 0;                    ///< of a picture when it is delivered
  std::uint32_t total = std::uint32_t(-1);  ///< pictures until it ends
  int width() const override { return kWidth; }
  int height() const override { return kHeight; }
  int channels() const override { return 1; }
  hal::CameraStatus next(const rt::MutableImageView&, std::uint8_t*, rt::TimeNs, hal::CapturedFrame* frame,
                         std::string*) override {
    trap.pass();
    if (next_ == total) return hal::CameraStatus::kEnd;
    nap(5 * rt::kNsPerMs);
    frame->sequence = next_++;
    frame->t_source_ns = frame->t_capture_ns = rt::monotonic_now_ns() - age_ns;
    return hal::CameraStatus::kFrame;
  }

 private:
  std::uint32_t next_ = 0;
};

class Stage final : public FrameStage {
 public:
  explicit Stage(rt::FramePool* pool) : return_(pool->reader(kTrackerReader)) {}
  Trap tracker, mapper;
  std::atomic<rt::TimeNs> map_ns{0};  ///< how long the mapper works on its next message
  void track(const rt::FrameHandle& frame, FrameRecord* record) override {
    tracker.pass();
    record->state = vo::State::kTracking;
    record->tracked = record->has_pose = true;
    return_.give_back(frame.slot, 2);
  }
  int mapper_backlog() const override { return 0; }
  bool map_step() override {
    mapper.pass();
    nap(map_ns.exchange(0));
    return false;
  }

 private:
  rt::FrameReturn return_;
};

class Detector final : public DetectorStage {
 public:
  Trap trap;
  std::atomic<bool> out_of_memory{false};
  std::atomic<int> asked{0};
  bool detect(const DetectorJob&) override {
    ++asked;
    trap.pass();
    if (out_of_memory.load()) throw std::bad_alloc();
    return true;
  }
};

class Sink final : public FrameSink {
 public:
  std::function<void()> on_take = [] {}, on_event = [] {}, on_turn = [] {};
  std::vector<std::string> said;
  rt::Result<void> take(const FrameRecord&) override {
    on_take();
    return {};
  }
  void event(const rt::LogEntry& e) override {
    said.push_back(std::string(e.what) + " " + e.which);
    on_event();
  }
  void turn(rt::TimeNs) override { on_turn(); }
};

std::unique_ptr<rt::FramePool> make_pool() {
  rt::FramePool::Layout layout;
  layout.width = kWidth;
  layout.height = kHeight;
  layout.slots = 12;
  layout.readers = kFrameReadersWithDetector;
  return std::move(rt::FramePool::create(layout)).value();
}

class PipelineFaults : public ::testing::Test {
 protected:
  PipelineFaults() : pool(make_pool()), stage(pool.get()) {
    options.newest_frame = true;
    options.detector = &detector;
    options.heartbeats = &heartbeats;
    options.abandon = [this](const char* thread) {
      if (abandoned.empty()) abandoned.emplace_back(thread);
      free_all();  // a program would end here
    };
  }
  void free_all() {
    for (Trap* trap : {&camera.trap, &stage.tracker, &stage.mapper, &detector.trap}) trap->free();
  }
  rt::Result<PipelineCounters> go() { return run_pipeline(&camera, &stage, pool.get(), options, &sink, stop); }
  /// The trap closes in flight; the thread is named, and the end comes all the same.
  void hangs(Trap* trap, const std::string& name) {
    int turns = 0;
    sink.on_turn = [&] {
      if (++turns == 5) trap->set.store(true);
      if (turns > 5 && heartbeats.silent(rt::monotonic_now_ns()).name != nullptr) stop.store(true);
    };
    ASSERT_TRUE(go().ok());
    ASSERT_EQ(abandoned.size(), 1u);
    EXPECT_EQ(abandoned[0], name);
    EXPECT_NE(std::find(sink.said.begin(), sink.said.end(), "no sign of life of " + name), sink.said.end());
  }

  Camera camera;
  std::unique_ptr<rt::FramePool> pool;
  Stage stage;
  Detector detector;
  Sink sink;
  rt::Heartbeats heartbeats;
  std::vector<std::string> abandoned;
  std::atomic<bool> stop{false};
  PipelineOptions options;
};

TEST_F(PipelineFaults, AMapperThatHangsIsNamedAndLeftBehind) {
  hangs(&stage.mapper, "gw-mapper");
}

TEST_F(PipelineFaults, ATrackerThatHangsIsNamedAndLeftBehind) {
  hangs(&stage.tracker, "gw-tracker");
}

TEST_F(PipelineFaults, ACameraThatHangsIsNamedAndLeftBehind) {
  hangs(&camera.trap, "gw-camera");
}

// As fast as it goes nobody is late: a slow mapper or tracker is waited for, until somebody wants the end.
TEST_F(PipelineFaults, AReplayWithoutAPaceWaitsForItsMapper) {
  options.newest_frame = false;
  camera.total = 3;
  stage.map_ns.store(kEndPatienceNs + 2 * rt::kNsPerSecond);
  const auto counters = go();
  ASSERT_TRUE(counters.ok());
  EXPECT_EQ(counters.value().processed, 3u);
  EXPECT_TRUE(abandoned.empty()) << abandoned[0];
}

TEST_F(PipelineFaults, AReplayWithoutAPaceThatIsToEndWaitsNoLongerThanAFlight) {
  options.newest_frame = false;
  camera.total = 3;
  stage.mapper.set.store(true);
  std::thread user([this] {
    nap(rt::kNsPerSecond);
    stop.store(true);
  });
  const rt::TimeNs begin = rt::monotonic_now_ns();
  EXPECT_TRUE(go().ok());
  user.join();
  EXPECT_EQ(abandoned, std::vector<std::string>{"gw-mapper"});
  EXPECT_GE(rt::monotonic_now_ns() - begin, kEndPatienceNs);
}

TEST_F(PipelineFaults, ADetectorThatHangsKeepsNoEndAway) {
  detector.trap.set.store(true);
  sink.on_turn = [&] { stop.store(stop.load() || detector.asked.load() > 0); };
  ASSERT_TRUE(go().ok());
  ASSERT_EQ(abandoned.size(), 1u);
  EXPECT_EQ(abandoned[0], "gw-detector");
}

// No time is left; its own patience is 4 s.
TEST_F(PipelineFaults, NobodyIsWaitedForLongerThanUntilTheProcessIsToEnd) {
  rt::begin_process_end();
  nap(rt::kProcessEndNs);
  detector.trap.set.store(true);
  std::atomic<bool> over{false};
  std::thread at_last;
  sink.on_turn = [&] {
    if (stop.load() || detector.asked.load() == 0) return;
    stop.store(true);
    at_last = std::thread([&] {
      // Turns, and not a time: on a machine that is busy they last longer, as those of who waits do.
      const auto turns = (kEndPatienceNs - rt::kNsPerSecond) / rt::kNsPerMs;
      for (rt::TimeNs turn = 0; turn < turns && !over.load(); ++turn) nap(rt::kNsPerMs);
      free_all();
    });
  };
  const auto run = go();
  over.store(true);
  rt::forget_process_end();
  at_last.join();
  ASSERT_TRUE(run.ok());
  ASSERT_FALSE(abandoned.empty());
  EXPECT_EQ(abandoned[0], "gw-detector");
}

TEST_F(PipelineFaults, ADetectorOutOfMemoryHasNoMaskAndTheFlightGoesOn) {
  detector.out_of_memory.store(true);
  sink.on_turn = [&] { stop.store(detector.asked.load() > 2); };
  const auto counters = go();
  ASSERT_TRUE(counters.ok());
  EXPECT_GE(counters.value().scheduler.detections_failed, 2u);
  EXPECT_NE(std::find(sink.said.begin(), sink.said.end(), "detections fail "), sink.said.end());
  EXPECT_TRUE(abandoned.empty());
}

TEST_F(PipelineFaults, ADetectorOutOfMemoryEndsNoSequentialRunEither) {
  detector.out_of_memory.store(true);
  options.sequential = true;
  camera.total = 30;
  const auto counters = go();
  ASSERT_TRUE(counters.ok());
  EXPECT_EQ(counters.value().processed, 30u);
  EXPECT_GT(detector.asked.load(), 2);
}

TEST_F(PipelineFaults, AnEventThatCannotBeToldEndsNothing) {
  int events = 0, taken = 0;
  sink.on_event = [&] {
    ++events;
    throw std::runtime_error("the log is gone");
  };
  sink.on_take = [&] { stop.store(++taken > 50); };
  ASSERT_TRUE(go().ok());
  EXPECT_GT(events, 0);
  EXPECT_GT(taken, 50);
}

TEST_F(PipelineFaults, ASinkThatThrowsEndsTheRunWithItsWords) {
  sink.on_take = [] { throw std::runtime_error("the disc is gone"); };
  const auto counters = go();
  ASSERT_FALSE(counters.ok());
  EXPECT_EQ(counters.error().message, "the disc is gone");
}

// The ladder is there for what this machine takes, not for what the camera takes.
TEST_F(PipelineFaults, ACameraThatDeliversLateCostsNoRung) {
  camera.age_ns = 400 * rt::kNsPerMs;
  options.scheduler.deadline_ns = 300 * rt::kNsPerMs;  // wide, so that a busy machine is no slip
  int taken = 0;
  sink.on_take = [&] { stop.store(++taken > 100); };
  const auto counters = go();
  ASSERT_TRUE(counters.ok());
  EXPECT_LT(counters.value().scheduler.slips, 10u) << "of 100, each 400 ms old";
}

TEST_F(PipelineFaults, TheSecondFlagEndsItToo) {
  std::atomic<bool> user{false};
  options.also_stop = &user;
  int turns = 0;
  sink.on_turn = [&] { user.store(++turns > 3); };
  EXPECT_TRUE(go().ok());
}

TEST_F(PipelineFaults, WhoEndsRightlyIsNotMissed) {
  sink.on_turn = [&] { stop.store(true); };
  ASSERT_TRUE(go().ok());
  EXPECT_EQ(heartbeats.silent(rt::monotonic_now_ns() + 60 * rt::kNsPerSecond).name, nullptr);
}

}  // namespace
}  // namespace godwit::app::pipeline_faults_test
