// Which pictures go to the detector: the same part in threads and in --sequential.
#include "firmware_app/pipeline/detection_orders.h"

#include <gtest/gtest.h>
#include <random>
#include <vector>

namespace godwit::app::detection_orders_test {
namespace {

constexpr rt::TimeNs kFrame = 33'333'333;

/// A pool whose slots all must come back.
class DetectionOrdersTest : public ::testing::Test {
 protected:
  DetectionOrdersTest() {
    rt::FramePool::Layout layout;
    layout.width = layout.height = 64;
    layout.slots = 8;
    layout.readers = 1;
    pool = std::move(rt::FramePool::create(layout)).value();
    options.detector = true;
    options.input_px = 416;
  }
  rt::FrameHandle frame(int number) {
    const int slot = pool->acquire();
    EXPECT_GE(slot, 0) << "slots are lost";
    pool->hand_out(slot, 1);
    rt::FrameHandle out{slot, {}};
    out.meta.sequence = static_cast<std::uint32_t>(number);
    out.meta.t_capture_ns = rt::kNsPerSecond + number * kFrame;
    return out;
  }
  int free_slots() {
    std::vector<int> got;
    for (int slot = pool->acquire(); slot >= 0; slot = pool->acquire()) got.push_back(slot);
    for (const int slot : got) pool->cancel(slot);
    return static_cast<int>(got.size());
  }
  std::unique_ptr<rt::FramePool> pool;
  SchedulerOptions options;
};

// --sequential: so many frames from one to the next, and each keyframe.
TEST_F(DetectionOrdersTest, CountingFramesTheyComeAsPlainCountingSays) {
  for (const int period : {1, 3, 7}) {
    options.period_frames = period;
    options.frame_ns = rt::kNsPerSecond / 2;  // a slow camera changes nothing
    Scheduler scheduler(counting_frames(options));
    rt::FrameReturn back = pool->reader(0);
    std::mt19937 random(1);
    int since = period;
    for (int i = 0; i < 500; ++i) {
      const bool keyframe = random() % 5 == 0;
      const auto job = order_detection(frame(i), keyframe, i, &scheduler, &back);
      const bool expected = ++since >= period || keyframe;
      ASSERT_EQ(job.has_value(), expected) << i;
      if (!job) continue;
      since = 0;
      EXPECT_EQ(job->frame.meta.sequence, static_cast<std::uint32_t>(i));
      EXPECT_EQ(job->is_keyframe, keyframe);
      EXPECT_EQ(job->input_px, 416);
      back.give_back(job->frame.slot);
      scheduler.detection_done(i, job->frame.meta.t_capture_ns, i % 3 == 0);
    }
    EXPECT_EQ(free_slots(), 8);
  }
}

TEST_F(DetectionOrdersTest, KeyframesThatCameMeanwhileAreNotKeptAndTheNewestPictureIsNext) {
  Scheduler scheduler(options);
  rt::FrameReturn back = pool->reader(0);
  const auto next = [&](int i, bool keyframe) {
    const rt::FrameHandle f = frame(i);
    return order_detection(f, keyframe, f.meta.t_capture_ns + rt::kNsPerMs, &scheduler, &back);
  };
  auto job = next(0, false);
  ASSERT_TRUE(job);
  for (int i = 1; i <= 3; ++i) EXPECT_FALSE(next(i, i != 3));
  EXPECT_EQ(free_slots(), 7) << "but for the one under way";
  EXPECT_EQ(scheduler.counters().keyframes_undetected, 2u);
  back.give_back(job->frame.slot);
  scheduler.detection_done(rt::kNsPerSecond + 3 * kFrame, job->frame.meta.t_capture_ns, false);
  job = next(4, false);
  ASSERT_TRUE(job) << "after its pause of a fifth";
  EXPECT_FALSE(job->is_keyframe);
  EXPECT_EQ(job->frame.meta.sequence, 4u);
  back.give_back(job->frame.slot);
  EXPECT_EQ(free_slots(), 8);
}

}  // namespace
}  // namespace godwit::app::detection_orders_test
