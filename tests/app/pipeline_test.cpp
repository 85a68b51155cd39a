// The pipeline with a camera and a stage made for the test: order, drops, back pressure, ends. Also run under the
// thread sanitizer.
#include "firmware_app/pipeline/pipeline.h"

#include <algorithm>
#include <gtest/gtest.h>
#include <set>
#include <vector>

#include "hal/rt/rt_scope.h"
#include "hal/rt/spsc_ring.h"
#include "hal/rt/wake_up.h"

namespace godwit::app {
namespace {

constexpr int kWidth = 64, kHeight = 64;

/// Pictures with their number in every pixel; some are bad, some never come at all.
class FakeCamera final : public hal::Camera {
 public:
  explicit FakeCamera(std::uint32_t total) : total_(total) {}
  std::set<std::uint32_t> bad;      ///< due, but not readable
  std::set<std::uint32_t> skipped;  ///< numbers that the device leaves out
  rt::TimeNs period_ns = 0;         ///< real pace, as ReplayCamera keeps it
  rt::TimeNs step_ns = 0;           ///< without a pace: by so much the capture times go on

  int width() const override { return kWidth; }
  int height() const override { return kHeight; }
  int channels() const override { return 1; }
  hal::CameraStatus next(const rt::MutableImageView& grey, std::uint8_t*, rt::TimeNs, hal::CapturedFrame* frame,
                         std::string* why) override {
    while (skipped.count(next_) != 0) ++next_;
    if (next_ >= total_) return hal::CameraStatus::kEnd;
    if (start_ns_ == 0) start_ns_ = period_ns > 0 ? rt::monotonic_now_ns() : rt::kNsPerSecond;
    frame->sequence = next_++;
    frame->t_source_ns = static_cast<rt::TimeNs>(frame->sequence) * 1000;
    frame->t_capture_ns = start_ns_ + static_cast<rt::TimeNs>(frame->sequence) * (period_ns + step_ns);
    if (period_ns > 0) rt::sleep_until_ns(frame->t_capture_ns);
    if (bad.count(frame->sequence) != 0) {
      *why = "spoilt";
      return hal::CameraStatus::kBadFrame;
    }
    if (grey.data == nullptr) return hal::CameraStatus::kFrame;
    for (int y = 0; y < grey.height; ++y) {
      for (int x = 0; x < grey.width; ++x) grey.row(y)[x] = static_cast<std::uint8_t>(frame->sequence);
    }
    return hal::CameraStatus::kFrame;
  }

 private:
  const std::uint32_t total_;
  std::uint32_t next_ = 0;
  rt::TimeNs start_ns_ = 0;
};

bool intact(const rt::FramePool& pool, const rt::FrameHandle& frame) {
  const rt::ImageView grey = pool.grey(frame.slot);
  const auto expected = static_cast<std::uint8_t>(frame.meta.sequence);
  return grey.at(0, 0) == expected && grey.at(kWidth - 1, kHeight - 1) == expected;
}

/// Every second frame goes to the mapper, which keeps the last few, as keyframes are kept.
class FakeStage final : public FrameStage {
 public:
  explicit FakeStage(rt::FramePool* pool)
      : pool_(pool), tracker_return_(pool->reader(kTrackerReader)), mapper_return_(pool->reader(kMapperReader)) {}
  rt::TimeNs track_ns = 0;  ///< how long a frame takes
  int track_calls_outside_scope = 0;
  std::uint64_t wrong_pixels = 0;  ///< tracker's own
  std::uint64_t wrong_kept = 0;    ///< mapper's own
  std::uint64_t mapped = 0;        ///< mapper's own
  std::vector<vo::State> states;   ///< one a frame, then the last again; empty: always tracking
  std::set<std::uint32_t> keyframes;
  std::atomic<std::uint32_t> seen{0};  ///< number of the newest frame
  std::uint64_t samples = 0, samples_late = 0, samples_wrong = 0;
  rt::TimeNs t_sample_ns = 0, t_frame_ns = 0;

  void track(const rt::FrameHandle& frame, FrameRecord* record) override {
    if (!rt::in_rt_scope()) ++track_calls_outside_scope;
    if (track_ns > 0) rt::sleep_until_ns(rt::monotonic_now_ns() + track_ns);
    if (!intact(*pool_, frame)) ++wrong_pixels;
    t_frame_ns = frame.meta.t_capture_ns;
    record->state = vo::State::kTracking;
    if (!states.empty()) {
      record->state = states[std::min<std::size_t>(frame.meta.sequence, states.size() - 1)];
      record->why = {"features", static_cast<std::int32_t>(frame.meta.sequence), 30};
    }
    record->tracked = record->has_pose = true;
    seen.store(frame.meta.sequence);
    record->is_keyframe = keyframes.count(frame.meta.sequence) != 0;
    const bool sent = frame.meta.sequence % 2 == 0 && to_mapper_.try_push(frame);
    tracker_return_.give_back(frame.slot, sent ? 1 : 2);
  }
  void take_imu(const hal::ImuSample& sample) override {
    ++samples;
    if (sample.t_ns <= t_sample_ns || !rt::in_rt_scope()) ++samples_wrong;
    if (sample.t_ns <= t_frame_ns) ++samples_late;
    t_sample_ns = sample.t_ns;
  }
  int mapper_backlog() const override { return static_cast<int>(to_mapper_.size()); }
  bool map_step() override {
    rt::FrameHandle frame;
    if (!to_mapper_.try_pop(&frame)) return false;
    kept_.push_back(frame);
    if (kept_.size() > 3) {
      if (!intact(*pool_, kept_.front())) ++wrong_kept;
      mapper_return_.give_back(kept_.front().slot);
      kept_.erase(kept_.begin());
    }
    ++mapped;
    return true;
  }

 private:
  rt::FramePool* pool_;
  rt::FrameReturn tracker_return_, mapper_return_;
  rt::SpscRing<rt::FrameHandle, 8> to_mapper_;
  std::vector<rt::FrameHandle> kept_;
};

/// 1000 samples a second from one second on; some are spoilt.
class FakeImu final : public hal::Imu {
 public:
  explicit FakeImu(int total) : total_(total) {}
  std::set<int> missing, faults, backwards;
  bool real_pace = false;

  double rate_hz() const override { return 1000; }
  hal::ImuStatus next(hal::ImuSample* sample, rt::TimeNs timeout_ns) override {
    if (start_ns_ == 0) start_ns_ = real_pace ? rt::monotonic_now_ns() : rt::kNsPerSecond;
    while (missing.count(next_) != 0) ++next_;
    if (next_ >= total_) return hal::ImuStatus::kEnd;
    const rt::TimeNs due = start_ns_ + next_ * rt::kNsPerMs;
    if (real_pace) {
      const rt::TimeNs give_up = rt::monotonic_now_ns() + timeout_ns;
      rt::sleep_until_ns(std::min(due, give_up));
      if (due > give_up) return hal::ImuStatus::kTimeout;
    }
    sample->t_ns = backwards.count(next_) != 0 ? rt::kNsPerMs : due;
    return faults.count(next_++) != 0 ? hal::ImuStatus::kFault : hal::ImuStatus::kSample;
  }

 private:
  const int total_;
  int next_ = 0;
  rt::TimeNs start_ns_ = 0;
};

/// Its first detection takes until the stage has seen a certain frame; some detections later it ends the run.
class HeldDetector final : public DetectorStage {
 public:
  HeldDetector(const rt::FramePool* pool, const std::atomic<std::uint32_t>* seen, std::atomic<bool>* stop)
      : pool_(pool), seen_(seen), stop_(stop) {}
  std::uint32_t until = 0;
  std::size_t enough = 4;
  std::vector<DetectorJob> jobs;
  std::uint64_t wrong_pixels = 0;
  bool detect(const DetectorJob& job) override {
    for (int ms = 0; jobs.empty() && seen_->load() < until && !stop_->load(); ++ms) {
      rt::sleep_until_ns(rt::monotonic_now_ns() + rt::kNsPerMs);
      if (ms == 20'000) stop_->store(true);  // the pictures have stopped coming
    }
    if (!intact(*pool_, job.frame)) ++wrong_pixels;
    jobs.push_back(job);
    if (jobs.size() == enough) stop_->store(true);
    return true;
  }

 private:
  const rt::FramePool* pool_;
  const std::atomic<std::uint32_t>* seen_;
  std::atomic<bool>* stop_;
};

class Collect final : public FrameSink {
 public:
  std::vector<FrameRecord> records;
  std::size_t fail_at = SIZE_MAX;
  std::size_t stop_at = SIZE_MAX;
  std::atomic<bool>* stop = nullptr;
  rt::Result<void> take(const FrameRecord& record) override {
    if (records.size() == fail_at) return rt::Error{"the disk is full"};
    records.push_back(record);
    if (records.size() == stop_at) stop->store(true);
    return {};
  }
  std::vector<rt::LogEntry> events;
  void event(const rt::LogEntry& entry) override { events.push_back(entry); }
};

std::unique_ptr<rt::FramePool> make_pool(int slots, int readers) {
  rt::FramePool::Layout layout;
  layout.width = kWidth;
  layout.height = kHeight;
  layout.slots = slots;
  layout.readers = readers;
  return std::move(rt::FramePool::create(layout)).value();
}

struct TestRun {
  explicit TestRun(std::uint32_t frames, int slots = 12, int readers = kFrameReaders)
      : camera(frames), pool(make_pool(slots, readers)), stage(pool.get()) {}
  FakeCamera camera;
  std::unique_ptr<rt::FramePool> pool;
  FakeStage stage;
  Collect sink;
  std::atomic<bool> stop{false};
  PipelineOptions options;
  rt::Result<PipelineCounters> go() { return run_pipeline(&camera, &stage, pool.get(), options, &sink, stop); }
};

void expect_each_once_in_order(const std::vector<FrameRecord>& records, std::uint32_t frames) {
  ASSERT_EQ(records.size(), frames);
  for (std::uint32_t i = 0; i < frames; ++i) {
    EXPECT_EQ(records[i].sequence, i);
    EXPECT_EQ(records[i].t_source_ns, static_cast<rt::TimeNs>(i) * 1000) << "carried through unchanged";
  }
}

class BothModes : public testing::TestWithParam<bool> {};
INSTANTIATE_TEST_SUITE_P(Pipeline, BothModes, testing::Bool(),
                         [](const auto& chosen) { return chosen.param ? "sequential" : "threads"; });

TEST_P(BothModes, EveryPictureIsProcessedOnceAndInOrder) {
  TestRun run(2000);
  run.options.sequential = GetParam();
  const auto counters = run.go();
  ASSERT_TRUE(counters.ok());
  expect_each_once_in_order(run.sink.records, 2000);
  EXPECT_EQ(counters.value().processed, 2000u);
  EXPECT_EQ(counters.value().dropped_late + counters.value().dropped_slots, 0u) << "at full pace nothing is dropped";
  EXPECT_EQ(run.stage.wrong_pixels, 0u);
  EXPECT_EQ(run.stage.wrong_kept, 0u);
  EXPECT_GT(run.stage.mapped, 0u);
  EXPECT_EQ(run.stage.track_calls_outside_scope, 0) << "tracking is marked real-time";
}

TEST_P(BothModes, BadPicturesHaveTheirPlaceAndReason) {
  TestRun run(50);
  run.options.sequential = GetParam();
  run.camera.bad = {0, 7, 8, 9, 49};
  const auto counters = run.go();
  ASSERT_TRUE(counters.ok());
  expect_each_once_in_order(run.sink.records, 50);
  EXPECT_EQ(counters.value().bad, 5u);
  EXPECT_EQ(counters.value().processed, 45u);
  EXPECT_EQ(run.sink.records[8].fate, FrameFate::kBadPicture);
  EXPECT_EQ(run.sink.records[8].reason.view(), "spoilt");
  EXPECT_FALSE(run.sink.records[8].tracked);
}

TEST_P(BothModes, NumbersThatADeviceLeavesOutHoldNothingUp) {
  TestRun run(30);
  run.options.sequential = GetParam();
  run.camera.skipped = {0, 3, 4, 29};
  run.camera.bad = {5, 28};
  const auto counters = run.go();
  ASSERT_TRUE(counters.ok());
  ASSERT_EQ(run.sink.records.size(), 26u);
  for (std::size_t i = 1; i < run.sink.records.size(); ++i) {
    EXPECT_GT(run.sink.records[i].sequence, run.sink.records[i - 1].sequence);
  }
}

TEST_P(BothModes, TheTapHearsOfEachProcessedFrameInRealTime) {
  struct Tap final : FrameTap {
    std::uint64_t frames = 0, outside = 0;
    std::uint32_t last = 0;
    void frame_done(const FrameRecord& record) override {
      ++frames;
      last = record.sequence;
      if (!rt::in_rt_scope() || record.t_done_ns == 0) ++outside;
    }
  } tap;
  TestRun run(50);
  run.options.sequential = GetParam();
  run.options.tap = &tap;
  run.camera.bad = {3, 4};
  ASSERT_TRUE(run.go().ok());
  EXPECT_EQ(tap.frames, 48u);
  EXPECT_EQ(tap.last, 49u);
  EXPECT_EQ(tap.outside, 0u);
}

TEST_P(BothModes, AnEmptyCameraEndsAtOnce) {
  TestRun run(0);
  run.options.sequential = GetParam();
  const auto counters = run.go();
  ASSERT_TRUE(counters.ok());
  EXPECT_EQ(counters.value().due, 0u);
}

TEST_P(BothModes, AFailingSinkEndsTheRunWithItsError) {
  TestRun run(100'000'000);
  run.options.sequential = GetParam();
  run.sink.fail_at = 20;
  const auto counters = run.go();
  ASSERT_FALSE(counters.ok());
  EXPECT_EQ(counters.error().message, "the disk is full");
  EXPECT_EQ(run.sink.records.size(), 20u);
}

TEST_P(BothModes, StopEndsTheRun) {
  TestRun run(100'000'000);
  run.options.sequential = GetParam();
  run.sink.stop = &run.stop;
  run.sink.stop_at = 20;
  ASSERT_TRUE(run.go().ok());
  EXPECT_GE(run.sink.records.size(), 20u);
}

TEST_P(BothModes, EachFrameFindsWhatTheImuMeasuredBeforeIt) {
  TestRun run(300);
  run.options.sequential = GetParam();
  run.camera.step_ns = 33 * rt::kNsPerMs + 500'000;
  FakeImu imu(100'000);
  imu.missing = {2000};
  run.options.imu = &imu;
  const auto counters = run.go();
  ASSERT_TRUE(counters.ok() && counters.value().imu);
  EXPECT_EQ(run.stage.samples_late, 0u) << "handed over before the frame that was captured after it";
  EXPECT_EQ(run.stage.samples_wrong, 0u) << "in order, and under real-time rules";
  EXPECT_EQ(run.stage.samples, 10016u) << "the last frame is captured at 10.0165 s";
  EXPECT_EQ(counters.value().imu->gaps, 1u);
  EXPECT_EQ(counters.value().imu->dropped, 0u);
}

TEST_P(BothModes, EachChangeOfStateIsToldOnceWithItsReason) {
  TestRun run(100);
  run.options.sequential = GetParam();
  run.camera.step_ns = 33 * rt::kNsPerMs;
  run.camera.bad = {2, 5};
  using S = vo::State;
  run.stage.states = {S::kInitialising, S::kInitialising, S::kLost,         S::kTracking, S::kCoasting,
                      S::kLost,         S::kTracking,     S::kRelocalising, S::kLost,     S::kTracking};
  ASSERT_TRUE(run.go().ok());
  struct Change {
    const char *before, *which;
    int frame;
  };
  constexpr Change kExpected[] = {{"", "INITIALISING", 0},         {"INITIALISING", "TRACKING", 3},
                                  {"TRACKING", "COASTING", 4},     {"COASTING", "TRACKING", 6},
                                  {"TRACKING", "RELOCALISING", 7}, {"RELOCALISING", "LOST", 8},
                                  {"LOST", "TRACKING", 9}};
  ASSERT_EQ(run.sink.events.size(), std::size(kExpected));
  for (std::size_t i = 0; i < std::size(kExpected); ++i) {
    const rt::LogEntry& e = run.sink.events[i];
    EXPECT_STREQ(e.what, "state");
    EXPECT_STREQ(e.before, kExpected[i].before);
    EXPECT_STREQ(e.which, kExpected[i].which);
    EXPECT_STREQ(e.why, "features");
    EXPECT_EQ(e.value, kExpected[i].frame);
    EXPECT_EQ(e.limit, 30);
    EXPECT_EQ(e.t_ns, rt::kNsPerSecond + kExpected[i].frame * 33 * rt::kNsPerMs);
  }
}

TEST(Pipeline, WithoutAPaceAPauseOfThePicturesLosesNoSample) {
  TestRun run(3);
  run.camera.step_ns = 5 * rt::kNsPerSecond;
  FakeImu imu(100'000);
  run.options.imu = &imu;
  const auto counters = run.go();
  ASSERT_TRUE(counters.ok());
  EXPECT_EQ(run.stage.samples, 10'001u) << "five times what the ring holds, between two frames";
  EXPECT_EQ(run.stage.samples_late, 0u);
}

TEST(Pipeline, AtRealPaceTheImuHasItsOwnThreadAndItsFaultsAreCounted) {
  TestRun run(60);
  run.options.newest_frame = true;
  run.camera.period_ns = 10 * rt::kNsPerMs;
  FakeImu imu(1'000'000);
  imu.real_pace = true;
  imu.missing = {50};
  imu.faults = {60, 61};
  imu.backwards = {70};
  run.options.imu = &imu;
  const auto counters = run.go();
  ASSERT_TRUE(counters.ok() && counters.value().imu);
  const ImuCounters& c = *counters.value().imu;
  EXPECT_GT(c.samples, 400u);
  EXPECT_GE(c.gaps, 3u) << "one that is missing, one of two faults, one behind a time that is not believed";
  EXPECT_EQ(c.faults, 2u);
  EXPECT_EQ(c.implausible, 1u);
  EXPECT_EQ(c.dropped, 0u);
  EXPECT_EQ(run.stage.samples_wrong, 0u);
  EXPECT_GT(run.stage.samples, 400u);
  EXPECT_STREQ(counters.value().threads.back().name, "imu");
}

TEST(Pipeline, AnImuThatEndsInTheMiddleIsCalledSilentOnce) {
  TestRun run(100);
  run.camera.step_ns = 33 * rt::kNsPerMs;
  FakeImu imu(1000);
  run.options.imu = &imu;
  const auto counters = run.go();
  ASSERT_TRUE(counters.ok());
  EXPECT_EQ(counters.value().imu->silences, 1u);
  ASSERT_EQ(run.sink.events.size(), 2u) << "the first is the first state";
  const rt::LogEntry& e = run.sink.events[1];
  EXPECT_STREQ(e.what, "IMU silent");
  EXPECT_NEAR(e.value, 0.519, 1e-9) << "its last sample is of 0.999 s, the frame of 1.518 s";
  EXPECT_NEAR(e.limit, 0.5, 1e-9);
}

TEST(Pipeline, AtRealPaceTheNewestFrameWinsAndDropsAreCounted) {
  TestRun run(60);
  run.options.newest_frame = true;
  run.camera.period_ns = 2 * rt::kNsPerMs;
  run.stage.track_ns = 7 * rt::kNsPerMs;
  const auto counters = run.go();
  ASSERT_TRUE(counters.ok());
  expect_each_once_in_order(run.sink.records, 60);
  const PipelineCounters& c = counters.value();
  EXPECT_EQ(c.processed + c.dropped_late + c.dropped_slots, 60u);
  EXPECT_GT(c.dropped_late, 10u) << "three of four frames come while the tracker works";
  EXPECT_GT(c.processed, 3u);
  EXPECT_EQ(run.stage.wrong_pixels, 0u);
}

TEST(Pipeline, ExhaustedSlotsDropTheNewestFrameAndCountIt) {
  // The mapper keeps three frames and the tracker works on one: with four slots the camera finds none now and then.
  TestRun run(60, 4);
  run.options.newest_frame = true;
  run.camera.period_ns = rt::kNsPerMs;
  run.stage.track_ns = 5 * rt::kNsPerMs;
  const auto counters = run.go();
  ASSERT_TRUE(counters.ok());
  expect_each_once_in_order(run.sink.records, 60);
  EXPECT_GT(counters.value().dropped_slots, 0u);
  EXPECT_EQ(counters.value().dropped_slots, run.pool->exhausted());
  EXPECT_EQ(run.stage.wrong_pixels, 0u);
  EXPECT_EQ(run.stage.wrong_kept, 0u);
}

/// While the first detection is under way, frames 10 to 25 become keyframes; it ends with frame 30 at the earliest.
/// There are more keyframes than slots: if theirs are not given back, frame 30 never comes.
struct DetectedRun : TestRun {
  DetectedRun() : TestRun(100'000, 12, kFrameReadersWithDetector), detector(pool.get(), &stage.seen, &stop) {
    camera.step_ns = stage.track_ns = options.scheduler.frame_ns = rt::kNsPerMs;
    for (std::uint32_t i = 10; i <= 25; ++i) stage.keyframes.insert(i);
    detector.until = 30;
    options.detector = &detector;
    options.scheduler.mask_age_ns = 1000 * rt::kNsPerSecond;
  }
  HeldDetector detector;
};

TEST(Pipeline, KeyframesThatCameDuringADetectionGetTheNext) {
  DetectedRun run;
  const auto counters = run.go();
  ASSERT_TRUE(counters.ok());
  const std::vector<DetectorJob>& jobs = run.detector.jobs;
  ASSERT_GE(jobs.size(), 4u);
  for (std::uint32_t i = 1; i <= 2; ++i) {
    EXPECT_TRUE(jobs[i].is_keyframe);
    EXPECT_EQ(jobs[i].frame.meta.sequence, 23u + i) << "the newest two, in order";
  }
  EXPECT_FALSE(jobs[3].is_keyframe);
  EXPECT_GE(jobs[3].frame.meta.sequence, 30u) << "and then the newest picture again";
  EXPECT_EQ(run.detector.wrong_pixels, 0u) << "their slots are kept for them";
  EXPECT_EQ(counters.value().scheduler.keyframes_undetected, 14u) << "of 16";
}

TEST(Pipeline, AKeyframeWhoseMaskWouldComeTooLateMakesWay) {
  DetectedRun run;
  run.options.scheduler.mask_age_ns = 1;
  run.detector.enough = 2;
  const auto counters = run.go();
  ASSERT_TRUE(counters.ok());
  const std::vector<DetectorJob>& jobs = run.detector.jobs;
  ASSERT_GE(jobs.size(), 2u);
  EXPECT_FALSE(jobs[1].is_keyframe);
  EXPECT_GE(jobs[1].frame.meta.sequence, 30u);
  EXPECT_EQ(counters.value().scheduler.keyframes_undetected, 16u);
}

}  // namespace
}  // namespace godwit::app
