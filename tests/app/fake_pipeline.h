// A camera, a stage, an inertial sensor and a sink made for tests of the pipeline.
#pragma once

#include <algorithm>
#include <gtest/gtest.h>
#include <set>
#include <vector>

#include "firmware_app/pipeline/pipeline.h"
#include "hal/rt/rt_scope.h"
#include "hal/rt/spsc_ring.h"
#include "hal/rt/wake_up.h"

namespace godwit::app {

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

inline bool intact(const rt::FramePool& pool, const rt::FrameHandle& frame) {
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
  rt::TimeNs last_row_ns = 0;  ///< after the capture time

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
  rt::TimeNs read_after_ns() const override { return last_row_ns; }
  void take_imu(const hal::ImuSample& sample) override {
    ++samples;
    if (sample.t_ns <= t_sample_ns || !rt::in_rt_scope()) ++samples_wrong;
    if (sample.t_ns <= t_frame_ns + last_row_ns) ++samples_late;
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
  std::vector<rt::TimeNs> readings;
  void reading(const hal::ImuSample& sample) override { readings.push_back(sample.t_ns); }
  std::vector<rt::LogEntry> events;
  void event(const rt::LogEntry& entry) override { events.push_back(entry); }
};

inline std::unique_ptr<rt::FramePool> make_pool(int slots, int readers) {
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

inline void expect_each_once_in_order(const std::vector<FrameRecord>& records, std::uint32_t frames) {
  ASSERT_EQ(records.size(), frames);
  for (std::uint32_t i = 0; i < frames; ++i) {
    EXPECT_EQ(records[i].sequence, i);
    EXPECT_EQ(records[i].t_source_ns, static_cast<rt::TimeNs>(i) * 1000) << "carried through unchanged";
  }
}

}  // namespace godwit::app
