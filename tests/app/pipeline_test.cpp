// The pipeline with a camera and a stage made for the test, in threads and in one: order, drops, ends. Also run under
// the thread sanitizer.
#include <iterator>

#include "tests/app/fake_pipeline.h"

namespace godwit::app::pipeline_test {
namespace {

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

TEST_P(BothModes, AFrameOfARollingShutterFindsWhatTheImuMeasuredUpToItsLastRow) {
  TestRun run(300);
  run.options.sequential = GetParam();
  run.camera.step_ns = 33 * rt::kNsPerMs + 500'000;
  run.stage.last_row_ns = 15 * rt::kNsPerMs;
  FakeImu imu(100'000);
  run.options.imu = &imu;
  ASSERT_TRUE(run.go().ok());
  EXPECT_EQ(run.stage.samples_late, 0u);
  EXPECT_EQ(run.stage.samples_wrong, 0u);
  EXPECT_EQ(run.stage.samples, 10032u) << "the last frame's last row is read at 10.0315 s";
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

}  // namespace
}  // namespace godwit::app::pipeline_test
