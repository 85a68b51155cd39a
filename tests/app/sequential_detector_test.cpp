// The detector in a sequential run: which pictures it looks at, and before which one its answer is there.
#include <gmock/gmock.h>

#include "tests/app/fake_pipeline.h"

namespace godwit::app::sequential_detector_test {
namespace {

using testing::ElementsAre;
using testing::Pair;

/// Notes which picture it looks at, and how many the tracker had then seen.
class NotingDetector final : public DetectorStage {
 public:
  explicit NotingDetector(const TestRun* run) : run_(run) {}
  std::vector<std::pair<std::uint32_t, std::uint32_t>> looks;  ///< picture, newest one that was tracked by then
  std::uint64_t wrong_pixels = 0;
  bool detect(const DetectorJob& job) override {
    if (!intact(*run_->pool, job.frame)) ++wrong_pixels;
    looks.emplace_back(job.frame.meta.sequence, run_->stage.seen.load());
    return true;
  }

 private:
  const TestRun* run_;
};

struct DetectedRun : TestRun {
  explicit DetectedRun(std::uint32_t frames) : TestRun(frames, 12, kFrameReadersWithDetector), detector(this) {
    camera.step_ns = 100 * rt::kNsPerMs;
    options.scheduler.frame_ns = camera.step_ns;
    options.sequential = true;
    options.detector = &detector;
  }
  NotingDetector detector;
};

TEST(SequentialDetector, WithoutATimeOfItsOwnEveryThirdPictureIsLookedAtAtOnce) {
  DetectedRun run(10);
  ASSERT_TRUE(run.go().ok());
  EXPECT_THAT(run.detector.looks, ElementsAre(Pair(0, 0), Pair(3, 3), Pair(6, 6), Pair(9, 9)));
}

TEST(SequentialDetector, AnAnswerComesWithTheFirstPictureThatIsLateEnough) {
  DetectedRun run(12);
  run.options.sequential_detection_ns = 250 * rt::kNsPerMs;
  ASSERT_TRUE(run.go().ok());
  // Asked with picture 0, done 250 ms later: there before picture 3 is tracked, which is the next to be looked at. What
  // picture 9 shows would be there before the thirteenth.
  EXPECT_THAT(run.detector.looks, ElementsAre(Pair(0, 2), Pair(3, 5), Pair(6, 8)));
  EXPECT_EQ(run.detector.wrong_pixels, 0u) << "its slot is kept for it";
}

TEST(SequentialDetector, WhatIsUnderWayWhenTheRunEndsGivesItsPictureBack) {
  DetectedRun run(3);
  run.options.sequential_detection_ns = rt::kNsPerSecond;
  ASSERT_TRUE(run.go().ok());
  EXPECT_THAT(run.detector.looks, ElementsAre());
  // The mapper keeps one of the three, picture 0 and 2.
  int free = 0;
  while (run.pool->acquire() >= 0) ++free;
  EXPECT_EQ(free, 10);
}

TEST(SequentialDetector, TwoRunsAreEqual) {
  std::vector<std::pair<std::uint32_t, std::uint32_t>> looks[2];
  for (auto& of : looks) {
    DetectedRun run(100);
    run.stage.keyframes = {5, 17, 18, 60};
    run.options.sequential_detection_ns = 85 * rt::kNsPerMs;
    ASSERT_TRUE(run.go().ok());
    of = run.detector.looks;
  }
  EXPECT_GT(looks[0].size(), 20u);
  EXPECT_EQ(looks[0], looks[1]);
}

}  // namespace
}  // namespace godwit::app::sequential_detector_test
