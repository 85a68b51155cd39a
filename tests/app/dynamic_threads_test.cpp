// DynamicMasks as it flies: detections on one thread, masks on another, pictures through the pool.
#include <atomic>
#include <cmath>
#include <gtest/gtest.h>
#include <thread>

#include "firmware_app/dynamic/dynamic_masks.h"
#include "hal/rt/spsc_ring.h"
#include "hal/rt/wake_up.h"

namespace godwit::app {
namespace {

constexpr int kWidth = 320, kHeight = 240;
constexpr int kDetector = 0, kTracker = 1;
constexpr rt::TimeNs kFrame = 33 * rt::kNsPerMs;

void draw(const rt::MutableImageView& grey, int time) {
  for (int y = 0; y < grey.height; ++y)
    for (int x = 0; x < grey.width; ++x)
      grey.row(y)[x] = static_cast<std::uint8_t>(128 + 60 * std::sin(0.21 * (x - 3 * time) + 0.05 * y) +
                                                 40 * std::cos(0.17 * y - 0.03 * x));
}

TEST(DynamicThreads, DetectionsAndMasksCrossThreads) {
  rt::FramePool::Layout layout;
  layout.width = kWidth;
  layout.height = kHeight;
  layout.slots = 4;
  layout.readers = 2;
  const auto pool = std::move(rt::FramePool::create(layout)).value();
  DynamicMasksOptions options;
  options.model = GODWIT_MODEL_DIR "/cbam_yolov5n_320.onnx";
  options.detector.decode.score_threshold = 1e-5F;  // boxes of anything
  options.detector.threads = 1;
  const auto camera = vo::CameraModel::pinhole_radtan(kWidth, kHeight, 250, 250, 159.5, 119.5, {});
  auto opened = DynamicMasks::open(options, camera.value(), pool.get());
  ASSERT_TRUE(opened) << opened.error().message;
  DynamicMasks* const masks = opened.value().get();

  rt::SpscRing<DetectorJob, 2> jobs;
  std::atomic<bool> done{false};
  std::atomic<int> detected{0};
  std::thread detector([&] {
    rt::FrameReturn back = pool->reader(kDetector);
    // Acquire, partner: the release store below; after it no job comes.
    for (bool last = false; !last;) {
      last = done.load(std::memory_order_acquire);
      DetectorJob job;
      while (jobs.try_pop(&job)) {
        EXPECT_TRUE(masks->detect(job));
        back.give_back(job.frame.slot);
        detected.fetch_add(1);
      }
      rt::sleep_until_ns(rt::monotonic_now_ns() + rt::kNsPerMs);
    }
  });
  rt::FrameReturn back = pool->reader(kTracker);
  int masked = 0, late = 0;
  rt::TimeNs known_ns = 0;
  const rt::TimeNs give_up = rt::monotonic_now_ns() + 120 * rt::kNsPerSecond;
  for (int i = 0; (detected.load() < 8 || masked < 20) && rt::monotonic_now_ns() < give_up; ++i) {
    const int slot = pool->acquire();
    if (slot < 0) {
      rt::sleep_until_ns(rt::monotonic_now_ns() + rt::kNsPerMs);
      continue;
    }
    draw(pool->grey(slot), i);
    rt::FrameMeta meta;
    meta.t_capture_ns = (i + 1) * kFrame;
    pool->hand_out(slot, 2);
    if (!jobs.try_push({{slot, meta}, 320, false})) back.give_back(slot);
    const rt::MaskPyramidView mask = masks->mask_for(meta, pool->grey(slot));
    masked += detected.load() > 0 && mask.levels > 0 ? 1 : 0;
    rt::MaskPyramidView late_mask;
    const rt::TimeNs t_ns = masks->late_mask(meta.t_capture_ns - 5 * kFrame, known_ns, &late_mask);
    late += t_ns > known_ns ? 1 : 0;
    known_ns = t_ns;
    masks->frame_tracked({meta.t_capture_ns, 1, vo::SE3(), {}});
    back.give_back(slot);
  }
  done.store(true, std::memory_order_release);
  detector.join();
  EXPECT_GE(detected.load(), 8);
  EXPECT_GE(masked, 20) << "what never crossed proves nothing";
  std::printf("%d detections, %d masks made with one, %d late ones\n", detected.load(), masked, late);
}

}  // namespace
}  // namespace godwit::app
