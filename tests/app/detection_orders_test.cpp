// Which pictures go to the detector: the same part in threads and in --sequential.
#include "firmware_app/pipeline/detection_orders.h"

#include <gtest/gtest.h>
#include <random>
#include <vector>

namespace godwit::app::detection_orders_test {
namespace {

constexpr rt::TimeNs kFrame = 33'333'333;

/// A pool whose slots all must come back, and the orders of one flight.
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
    DetectionOrders orders(false, options.mask_age_ns);
    rt::FrameReturn back = pool->reader(0);
    std::mt19937 random(1);
    int since = period;
    for (int i = 0; i < 500; ++i) {
      const bool keyframe = random() % 5 == 0;
      const auto job = orders.next(frame(i), keyframe, i, &scheduler, &back);
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

TEST_F(DetectionOrdersTest, WhileOneIsUnderWayTheNewestTwoKeyframesWait) {
  Scheduler scheduler(options);
  DetectionOrders orders(true, options.mask_age_ns);
  rt::FrameReturn back = pool->reader(0);
  const auto next = [&](int i, bool keyframe) {
    const rt::FrameHandle f = frame(i);
    return orders.next(f, keyframe, f.meta.t_capture_ns + rt::kNsPerMs, &scheduler, &back);
  };
  auto job = next(0, false);
  ASSERT_TRUE(job);
  for (int i = 1; i <= 4; ++i) EXPECT_FALSE(next(i, i != 2));
  EXPECT_EQ(free_slots(), 5) << "the one under way and two keyframes";
  back.give_back(job->frame.slot);
  scheduler.detection_done(rt::kNsPerSecond + 4 * kFrame, job->frame.meta.t_capture_ns, false);
  EXPECT_EQ(scheduler.counters().keyframes_undetected, 1u);
  job = next(6, false);
  ASSERT_TRUE(job) << "after its pause of a fifth";
  EXPECT_TRUE(job->is_keyframe);
  EXPECT_EQ(job->frame.meta.sequence, 3u) << "the oldest that waits";
}

TEST_F(DetectionOrdersTest, AKeyframeWhoseMaskWouldComeTooLateMakesWay) {
  Scheduler scheduler(options);
  DetectionOrders orders(true, options.mask_age_ns);
  rt::FrameReturn back = pool->reader(0);
  const rt::FrameHandle first = frame(0), key = frame(1), late = frame(30);
  ASSERT_TRUE(orders.next(first, false, first.meta.t_capture_ns, &scheduler, &back));
  EXPECT_FALSE(orders.next(key, true, key.meta.t_capture_ns, &scheduler, &back));
  back.give_back(first.slot);
  scheduler.detection_done(key.meta.t_capture_ns, first.meta.t_capture_ns, false);
  const auto job = orders.next(late, false, late.meta.t_capture_ns, &scheduler, &back);
  ASSERT_TRUE(job);
  EXPECT_EQ(job->frame.meta.sequence, 30u) << "a second later";
  EXPECT_FALSE(job->is_keyframe);
  EXPECT_EQ(scheduler.counters().keyframes_undetected, 1u);
}

}  // namespace
}  // namespace godwit::app::detection_orders_test
