// What goes wrong in flight, with the real odometry at real pace: tracking goes on, or the state says that it does not.
#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <mutex>
#include <thread>

#include "hal/rt/wake_up.h"
#include "tests/realtime/flown.h"

namespace godwit::app {
namespace {

using testing::HasSubstr;

constexpr rt::TimeNs kInterval = 33'333'333;

/// Passes another camera's pictures on and spoils them as the test says.
class SpoiltCamera final : public hal::Camera {
 public:
  explicit SpoiltCamera(std::unique_ptr<LoopedPictures> good) : good_(std::move(good)) {}
  /// From picture `first` on, `count` of them never come; their time passes.
  int silent_first = -1, silent_count = 0;
  /// From picture `first` on, `count` of them carry a capture time that is off by so much.
  int jump_first = -1, jump_count = 0;
  rt::TimeNs jump_ns = 0;

  int width() const override { return good_->width(); }
  int height() const override { return good_->height(); }
  int channels() const override { return 1; }
  hal::CameraStatus next(const rt::MutableImageView& grey, std::uint8_t* bgr, rt::TimeNs timeout_ns,
                         hal::CapturedFrame* frame, std::string* why) override {
    const hal::CameraStatus status = good_->next(grey, bgr, timeout_ns, frame, why);
    if (status != hal::CameraStatus::kFrame) return status;
    const auto number = static_cast<int>(frame->sequence);
    if (number >= silent_first && number < silent_first + silent_count) return hal::CameraStatus::kTimeout;
    if (number >= jump_first && number < jump_first + jump_count) frame->t_capture_ns += jump_ns;
    return status;
  }

 private:
  std::unique_ptr<LoopedPictures> good_;
};

/// What an autopilot would have been told, by time.
class Told final : public FrameTap {
 public:
  void frame_done(const FrameRecord& record) override {
    if (record.tracked) last_pose_ns_.store(record.t_done_ns);
  }
  void no_picture(rt::TimeNs now_ns, rt::TimeNs t_last_capture_ns) override {
    silences.fetch_add(1);
    longest_ns.store(std::max(longest_ns.load(), now_ns - t_last_capture_ns));
  }
  void imu_silent(bool silent) override { imu_told.fetch_add(silent ? 1 : 100); }
  void detector_failed(bool failed) override { detector_told.fetch_add(failed ? 1 : 100); }
  std::atomic<int> imu_told{0};       ///< each silence 1, each end of one 100
  std::atomic<int> detector_told{0};  ///< each time it fails 1, each time it is back 100
  std::atomic<int> silences{0};
  std::atomic<rt::TimeNs> longest_ns{0};

 private:
  std::atomic<rt::TimeNs> last_pose_ns_{0};
};

struct FaultFlight {
  explicit FaultFlight(int frames, bool with_detector = false, rt::TimeNs interval_ns = kInterval)
      : odometry(with_detector), notes(static_cast<std::size_t>(frames)) {
    LoopedPictures::Options options;
    options.interval_ns = interval_ns;
    options.total = frames;
    camera = std::make_unique<SpoiltCamera>(test::camera_of(options));
    pipeline.newest_frame = true;
    pipeline.tap = &told;
    pipeline.scheduler.frame_ns = interval_ns;
  }
  PipelineCounters fly(FrameStage* stage = nullptr, FrameSink* sink = nullptr) {
    const std::atomic<bool> stop{false};
    auto run = run_pipeline(camera.get(), stage != nullptr ? stage : odometry.stage.get(), odometry.pool.get(),
                            pipeline, sink != nullptr ? sink : &notes, stop);
    EXPECT_TRUE(run.ok());
    return run.ok() ? run.value() : PipelineCounters{};
  }
  /// Share of the pictures from `first` on, up to `last`, that were tracked.
  double tracked(std::uint32_t first, std::uint32_t last) const {
    int all = 0, good = 0;
    for (const FrameRecord& r : notes.records) {
      if (r.sequence < first || r.sequence >= last) continue;
      ++all;
      good += r.tracked ? 1 : 0;
    }
    return all > 0 ? static_cast<double>(good) / all : 0;
  }

  /// Each change of state that the frames show stands once in the log, with a reason, and nothing else does.
  void expect_states_told() const {
    std::vector<std::string> seen, told_of;
    for (const FrameRecord& r : notes.records) {
      if (r.fate == FrameFate::kProcessed && (seen.empty() || seen.back() != vo::state_name(r.state)))
        seen.emplace_back(vo::state_name(r.state));
    }
    for (const rt::LogEntry& e : notes.events) {
      if (e.what != std::string("state")) continue;
      EXPECT_STREQ(e.before, told_of.empty() ? "" : told_of.back().c_str());
      EXPECT_STRNE(e.why, "");
      told_of.emplace_back(e.which);
    }
    EXPECT_EQ(told_of, seen);
  }

  test::Odometry odometry;
  std::unique_ptr<SpoiltCamera> camera;
  test::Notes notes;
  Told told;
  PipelineOptions pipeline;
};

TEST(Fault, ADetectorThatHangsForTenSecondsIsGivenUpOnAndTrackingGoesOn) {
  constexpr rt::TimeNs kHangs = 10 * rt::kNsPerSecond;
  struct Hanging final : DetectorStage {
    std::atomic<int> calls{0};
    bool detect(const DetectorJob& job) override {
      EXPECT_GT(job.input_px, 0);
      if (++calls == 5) rt::sleep_until_ns(rt::monotonic_now_ns() + kHangs);
      return true;
    }
  } detector;
  FaultFlight f(400, true);
  f.pipeline.detector = &detector;
  f.pipeline.scheduler.detector_stuck_ns = 500 * rt::kNsPerMs;
  const PipelineCounters c = f.fly();
  EXPECT_EQ(c.scheduler.detector_stuck, 1u);
  ASSERT_TRUE(f.notes.heard("detector hangs"));
  ASSERT_TRUE(f.notes.heard("detector is back"));
  EXPECT_GT(f.notes.find("detector is back")->t_ns - f.notes.find("detector hangs")->t_ns, kHangs * 8 / 10);
  EXPECT_EQ(f.told.detector_told.load(), 101);
  EXPECT_GT(detector.calls.load(), 5) << "it works again";
  EXPECT_GT(f.tracked(60, 400), 0.9);
  EXPECT_EQ(f.odometry.pool->exhausted(), 0u) << "it holds one slot, not all";
}

TEST(Fault, ANetworkThatFailsForAWhileIsToldOnceAndSoIsItsReturn) {
  struct Failing final : DetectorStage {
    int calls = 0;
    bool detect(const DetectorJob&) override { return ++calls <= 2 || calls > 5; }
  } detector;
  FaultFlight f(90, true);
  f.pipeline.detector = &detector;
  const PipelineCounters c = f.fly();
  ASSERT_GT(detector.calls, 6) << "else there was no return";
  std::vector<std::string> told_of;
  for (const rt::LogEntry& e : f.notes.events) {
    if (std::string(e.what).starts_with("detections")) told_of.emplace_back(e.what);
  }
  EXPECT_EQ(told_of, (std::vector<std::string>{"detections come", "detections fail", "detections come"}));
  EXPECT_EQ(c.scheduler.detections_failed, 3u);
  EXPECT_EQ(f.told.detector_told.load(), 101) << "the autopilot hears of it";
}

TEST(Fault, AMapperThatStallsForTwoSecondsStopsNobody) {
  struct Stalling final : FrameStage {
    FrameStage* good = nullptr;
    std::atomic<std::uint32_t> frame{0};
    std::atomic<bool> stalled{false};
    void track(const rt::FrameHandle& handle, FrameRecord* record) override {
      good->track(handle, record);
      frame.store(handle.meta.sequence);
    }
    int mapper_backlog() const override { return good->mapper_backlog(); }
    bool map_step() override {
      if (frame.load() >= 60 && !stalled.exchange(true)) std::this_thread::sleep_for(std::chrono::seconds(2));
      return good->map_step();
    }
  } stalling;
  FaultFlight f(180);
  stalling.good = f.odometry.stage.get();
  const PipelineCounters c = f.fly(&stalling);
  EXPECT_TRUE(stalling.stalled.load());
  EXPECT_EQ(c.dropped_slots, 0u) << "what the mapper does not take holds no slots";
  EXPECT_GT(f.tracked(62, 180), 0.9);
}

TEST(Fault, ASilentCameraIsToldAndNoOldPoseIsGivenOut) {
  FaultFlight f(200);
  f.camera->silent_first = 60;
  f.camera->silent_count = 90;
  f.fly();
  EXPECT_TRUE(f.notes.heard("no picture"));
  EXPECT_TRUE(f.notes.heard("pictures again"));
  EXPECT_GT(f.told.silences.load(), 10) << "for three seconds, some ten times a second";
  EXPECT_GT(f.told.longest_ns.load(), 29 * rt::kNsPerSecond / 10);
  for (const FrameRecord& r : f.notes.records) EXPECT_FALSE(r.sequence >= 60 && r.sequence < 150) << r.sequence;
  ASSERT_FALSE(f.notes.records.empty());
  EXPECT_EQ(f.notes.records.back().sequence, 199u) << "and then it goes on";
  f.expect_states_told();
}

TEST(Fault, ASilentImuIsToldAndTrackingGoesOn) {
  FaultFlight f(150);
  test::RestingImu imu;
  imu.mute_from_ns = 2 * rt::kNsPerSecond;
  imu.mute_to_ns = 4 * rt::kNsPerSecond;
  f.pipeline.imu = &imu;
  const PipelineCounters c = f.fly();
  ASSERT_TRUE(c.imu);
  EXPECT_EQ(c.imu->silences, 1u);
  EXPECT_EQ(c.imu->dropped, 0u);
  EXPECT_GE(c.imu->gaps, 1u);
  EXPECT_EQ(f.told.imu_told.load(), 101) << "the autopilot's node hears of its beginning and its end";
  const rt::LogEntry* const silent = f.notes.find("IMU silent");
  ASSERT_NE(silent, nullptr);
  EXPECT_GT(silent->value, silent->limit);
  EXPECT_EQ(silent->limit, 0.5);
  EXPECT_TRUE(f.notes.heard("IMU heard again"));
  EXPECT_GT(f.tracked(60, 150), 0.9) << "pictures alone will do";
}

TEST(Fault, ACameraClockThatJumpsIsFoundOut) {
  for (const rt::TimeNs jump : {5 * rt::kNsPerSecond, -5 * rt::kNsPerSecond, -10 * rt::kNsPerMs * 5}) {
    FaultFlight f(120);
    f.camera->jump_first = 60;
    f.camera->jump_count = 12;
    f.camera->jump_ns = jump;
    const PipelineCounters c = f.fly();
    EXPECT_GT(c.bad, 0u);
    rt::TimeNs last = 0;
    for (const FrameRecord& r : f.notes.records) {
      if (r.fate == FrameFate::kBadPicture) {
        EXPECT_THAT(std::string(r.reason.view()), HasSubstr("camera clock: "));
      }
      if (r.fate != FrameFate::kProcessed) continue;
      EXPECT_GT(r.t_capture_ns, last) << "time never goes back for the odometry";
      EXPECT_GE(r.t_done_ns + 5 * rt::kNsPerMs, r.t_capture_ns) << "nor ahead of the clock";
      last = r.t_capture_ns;
    }
    EXPECT_GT(f.tracked(80, 120), 0.5) << "when the clock is right again it goes on";
    f.expect_states_told();
  }
}

TEST(Fault, ALogThatBlocksHoldsNothingUp) {
  struct Blocking final : FrameSink {
    explicit Blocking(test::Notes* notes) : notes_(notes) {}
    rt::Result<void> take(const FrameRecord& record) override {
      if (record.sequence == 30) std::this_thread::sleep_for(std::chrono::seconds(3));
      return notes_->take(record);
    }
    test::Notes* notes_;
  };
  // 100 frames a second: three seconds are more than the ring of records holds.
  FaultFlight f(600, false, 10 * rt::kNsPerMs);
  f.pipeline.scheduler.deadline_ns = rt::kNsPerSecond;
  Blocking blocking(&f.notes);
  const PipelineCounters c = f.fly(nullptr, &blocking);
  EXPECT_GT(c.records_lost, 0u);
  EXPECT_EQ(c.records_lost + c.due, 600u) << "what is lost is counted";
  EXPECT_EQ(c.dropped_slots, 0u);
  EXPECT_EQ(f.told.silences.load(), 0) << "the tracker never stood still";
}

/// Gives a picture only when it is allowed one: time that passes in pictures, on however busy a machine.
class SteppedCamera final : public hal::Camera {
 public:
  explicit SteppedCamera(std::unique_ptr<LoopedPictures> good) : good_(std::move(good)) {}
  int width() const override { return good_->width(); }
  int height() const override { return good_->height(); }
  int channels() const override { return 1; }
  hal::CameraStatus next(const rt::MutableImageView& grey, std::uint8_t* bgr, rt::TimeNs timeout_ns,
                         hal::CapturedFrame* frame, std::string* why) override {
    std::unique_lock<std::mutex> lock(mutex_);
    waiting_ = true;
    changed_.notify_all();
    changed_.wait(lock, [&] { return captured_ < allowed_; });
    waiting_ = false;
    const hal::CameraStatus status = good_->next(grey, bgr, timeout_ns, frame, why);
    frame->t_capture_ns = rt::monotonic_now_ns();
    ended_ = status == hal::CameraStatus::kEnd;
    if (ended_) changed_.notify_all();
    if (!ended_) ++captured_;
    return status;
  }
  /// Captures so many more, and returns when each has been handed on.
  void capture(int pictures) {
    std::unique_lock<std::mutex> lock(mutex_);
    allowed_ += pictures;
    changed_.notify_all();
    changed_.wait(lock, [&] { return ended_ || (captured_ == allowed_ && waiting_); });
  }
  /// The newest picture's number.
  std::int64_t newest() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return captured_ - 1;
  }

 private:
  std::unique_ptr<LoopedPictures> good_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::int64_t allowed_ = 1, captured_ = 0;
  bool waiting_ = false, ended_ = false;
};

TEST(Fault, SixtyFramesASecondGiveNoPoseOlderThanTwoFramesAndTheRestIsCounted) {
  // A tracker that needs 25 ms at 60 pictures a second: while it works on one, one or two more are captured, in turn.
  constexpr int kFrames = 239;
  struct Slow final : FrameStage {
    FrameStage* good = nullptr;
    SteppedCamera* camera = nullptr;
    int calls = 0;
    void track(const rt::FrameHandle& handle, FrameRecord* record) override {
      good->track(handle, record);
      camera->capture(1 + calls++ % 2);
    }
    int mapper_backlog() const override { return good->mapper_backlog(); }
    bool map_step() override { return good->map_step(); }
  } slow;
  struct Ages final : FrameTap {
    SteppedCamera* camera = nullptr;
    std::vector<std::int64_t> ages;
    void frame_done(const FrameRecord& record) override { ages.push_back(camera->newest() - record.sequence); }
  } told;
  LoopedPictures::Options pictures;
  pictures.real_pace = false;
  pictures.total = kFrames;
  SteppedCamera camera(test::camera_of(pictures));
  test::Odometry odometry;
  slow.good = odometry.stage.get();
  slow.camera = told.camera = &camera;
  test::Notes notes(kFrames);
  PipelineOptions options;
  options.newest_frame = true;
  options.tap = &told;
  options.scheduler.frame_ns = rt::kNsPerSecond / 60;
  const std::atomic<bool> stop{false};
  const auto run = run_pipeline(&camera, &slow, odometry.pool.get(), options, &notes, stop);
  ASSERT_TRUE(run.ok());
  EXPECT_EQ(run.value().due, static_cast<std::uint64_t>(kFrames));
  EXPECT_EQ(run.value().processed, 160u);
  EXPECT_EQ(run.value().dropped_late, 79u);
  EXPECT_EQ(told.ages.size(), run.value().processed);
  for (std::size_t i = 0; i < told.ages.size(); ++i) EXPECT_LE(told.ages[i], 2) << "pose " << i;
  // 0 1 3 4 6 7 ..: always the newest there was.
  std::vector<std::uint32_t> flown;
  for (const FrameRecord& r : notes.records) {
    if (r.fate == FrameFate::kProcessed) flown.push_back(r.sequence);
  }
  for (std::size_t i = 0; i < flown.size(); ++i) EXPECT_EQ(flown[i], i / 2 * 3 + i % 2);
}

}  // namespace
}  // namespace godwit::app
