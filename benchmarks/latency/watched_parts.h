// What the benchmark looks through: camera, tracker's tap and detector as they are, each with an eye on its own thread.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include "firmware_app/pipeline/detector_stage.h"
#include "firmware_app/pipeline/pipeline.h"
#include "hal/camera/camera.h"
#include "hal/rt/alloc_hook.h"
#include "hal/rt/time.h"

namespace godwit::bench {

/// Heap operations of one thread inside its real-time scopes since the first time that it was asked.
class HeapWatch {
 public:
  /// The thread itself. No allocation.
  void look() {
    const rt::HeapCounts c = rt::rt_heap_counts();
    const auto all = static_cast<std::int64_t>(c.allocations + c.frees);
    if (first_ < 0) first_ = all;
    // Relaxed: a figure, read after the thread's last look or a look late.
    count_.store(all - first_, std::memory_order_relaxed);
  }
  std::int64_t count() const { return count_.load(std::memory_order_relaxed); }

 private:
  std::int64_t first_ = -1;              ///< the thread's own
  std::atomic<std::int64_t> count_{-1};  ///< the thread -> the collector
};

/// The camera as it is, with an eye on its thread's heap. A live one is at its end after lasts_ns (0: by itself).
class WatchedCamera final : public hal::Camera {
 public:
  WatchedCamera(std::unique_ptr<hal::Camera> camera, rt::TimeNs lasts_ns, HeapWatch* heap)
      : camera_(std::move(camera)), lasts_ns_(lasts_ns), heap_(heap) {}
  int width() const override { return camera_->width(); }
  int height() const override { return camera_->height(); }
  int channels() const override { return camera_->channels(); }
  bool real_time() const override { return camera_->real_time(); }
  hal::CameraStatus next(const rt::MutableImageView& grey, std::uint8_t* bgr, rt::TimeNs timeout_ns,
                         hal::CapturedFrame* frame, std::string* why) override {
    heap_->look();
    if (lasts_ns_ > 0) {
      const rt::TimeNs now_ns = rt::monotonic_now_ns();
      if (t_end_ns_ == 0) t_end_ns_ = now_ns + lasts_ns_;
      if (now_ns >= t_end_ns_) return hal::CameraStatus::kEnd;
    }
    return camera_->next(grey, bgr, timeout_ns, frame, why);
  }
  rt::LogRing* events() override { return camera_->events(); }

 private:
  std::unique_ptr<hal::Camera> camera_;
  const rt::TimeNs lasts_ns_;
  rt::TimeNs t_end_ns_ = 0;
  HeapWatch* heap_;
};

/// Tracker's heap; everything else goes on to the autopilot.
class WatchedTap final : public app::FrameTap {
 public:
  WatchedTap(app::FrameTap* next, HeapWatch* heap) : next_(next), heap_(heap) {}
  void frame_begun() override {
    if (next_ != nullptr) next_->frame_begun();
  }
  void frame_done(const app::FrameRecord& record) override {
    if (next_ != nullptr) next_->frame_done(record);
    heap_->look();
  }
  void no_picture(rt::TimeNs now_ns, rt::TimeNs t_last_ns) override {
    if (next_ != nullptr) next_->no_picture(now_ns, t_last_ns);
  }
  void imu_silent(bool silent) override {
    if (next_ != nullptr) next_->imu_silent(silent);
  }
  void reading(const hal::ImuSample& sample) override {
    if (next_ != nullptr) next_->reading(sample);
  }
  void detector_failed(bool failed) override {
    if (next_ != nullptr) next_->detector_failed(failed);
  }

 private:
  app::FrameTap* next_;
  HeapWatch* heap_;
};

/// The detector as it is, with the thread CPU time of each detection. With more than one thread in OpenCV it is that of
/// the detector's own.
class WatchedDetector final : public app::DetectorStage {
 public:
  /// full_px: input of the network while the ladder has shed nothing.
  WatchedDetector(app::DetectorStage* detector, int full_px) : detector_(detector), full_px_(full_px) {}
  bool detect(const app::DetectorJob& job) override {
    const rt::TimeNs before_ns = rt::thread_cpu_now_ns();
    const bool found = detector_->detect(job);
    const double ms = rt::to_ms(rt::thread_cpu_now_ns() - before_ns);
    const std::lock_guard lock(mutex_);
    cpu_ms_[job.input_px < full_px_ ? 1 : 0].push_back(ms);
    return found;
  }
  /// Of all detections so far [ms], those of the full input and those of the small one; any thread.
  std::array<std::vector<double>, 2> cpu_ms() const {
    const std::lock_guard lock(mutex_);
    return cpu_ms_;
  }

 private:
  app::DetectorStage* detector_;
  const int full_px_;
  mutable std::mutex mutex_;
  std::array<std::vector<double>, 2> cpu_ms_;
};

}  // namespace godwit::bench
