// What only threads have: a pace, drops, an inertial sensor's thread, a detector that takes its time. Also run under
// the thread sanitizer.
#include "tests/app/fake_pipeline.h"

namespace godwit::app::pipeline_threads_test {
namespace {

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

TEST(Pipeline, WithoutAPaceAPauseOfThePicturesLosesNoSample) {
  TestRun run(3);
  run.camera.step_ns = 5 * rt::kNsPerSecond;
  FakeImu imu(100'000);
  run.options.imu = &imu;
  const auto counters = run.go();
  ASSERT_TRUE(counters.ok());
  EXPECT_EQ(run.stage.samples, 10'001u) << "five times what the ring holds, between two frames";
  EXPECT_EQ(run.stage.samples_late, 0u);
  EXPECT_EQ(run.sink.readings.size(), 10'001u) << "the sink has each of them, too";
  EXPECT_TRUE(std::is_sorted(run.sink.readings.begin(), run.sink.readings.end()));
}

TEST(Pipeline, InOneThreadTheSinkHasEachReading) {
  TestRun run(3);
  run.options.sequential = true;
  run.camera.step_ns = 5 * rt::kNsPerSecond;
  FakeImu imu(100'000);
  run.options.imu = &imu;
  ASSERT_TRUE(run.go().ok());
  EXPECT_EQ(run.stage.samples, 10'001u);
  EXPECT_EQ(run.sink.readings.size(), 10'001u) << "more than its ring holds, between two frames";
  EXPECT_FALSE(run.sink.records.at(2).load.known) << "nothing waits for anybody";
}

TEST(Pipeline, AFrameKnowsHowBusyTheFlightWas) {
  TestRun run(60);
  run.options.newest_frame = true;
  run.camera.period_ns = 5 * rt::kNsPerMs;
  run.stage.track_ns = 20 * rt::kNsPerMs;
  run.options.scheduler.deadline_ns = rt::kNsPerMs;
  ASSERT_TRUE(run.go().ok());
  std::uint64_t slips = 0;
  for (const FrameRecord& r : run.sink.records) {
    EXPECT_EQ(r.load.known, r.fate == FrameFate::kProcessed);
    if (!r.load.known) continue;
    EXPECT_EQ(r.load.slips, slips++) << "each was late; it is counted from the next one on";
    EXPECT_LT(r.load.mask_age_ns, 0);
    EXPECT_GE(r.load.slots_free, r.load.slots_fewest);
    EXPECT_LT(r.load.slots_fewest, 12);
  }
  EXPECT_GT(slips, 5u);
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

TEST(Pipeline, KeyframesThatCameDuringADetectionMakeWayForTheNewestPicture) {
  DetectedRun run;
  const auto counters = run.go();
  ASSERT_TRUE(counters.ok());
  const std::vector<DetectorJob>& jobs = run.detector.jobs;
  ASSERT_GE(jobs.size(), 2u);
  EXPECT_FALSE(jobs[1].is_keyframe);
  EXPECT_GE(jobs[1].frame.meta.sequence, 30u);
  EXPECT_EQ(run.detector.wrong_pixels, 0u) << "its slot is kept for it";
  EXPECT_EQ(counters.value().scheduler.keyframes_undetected, 16u);
}

}  // namespace
}  // namespace godwit::app::pipeline_threads_test
