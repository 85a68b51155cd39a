#include "firmware_app/pipeline/as_flown.h"

#include <bit>

#include "firmware_app/pipeline/feeder.h"
#include "firmware_app/pipeline/state_watch.h"
#include "hal/rt/rt_scope.h"

namespace godwit::app {
namespace {

/// The camera on the flight's clock: capture times are those of the log.
class FlownClock final : public hal::Camera {
 public:
  explicit FlownClock(hal::Camera* camera) : camera_(camera) {}
  int width() const override { return camera_->width(); }
  int height() const override { return camera_->height(); }
  int channels() const override { return camera_->channels(); }
  hal::CameraStatus next(const rt::MutableImageView& grey, std::uint8_t* bgr, rt::TimeNs timeout_ns,
                         hal::CapturedFrame* frame, std::string* why) override {
    const hal::CameraStatus status = camera_->next(grey, bgr, timeout_ns, frame, why);
    frame->t_capture_ns += shift_ns_;
    return status;
  }
  void turning(double rate_rad_s) override { camera_->turning(rate_rad_s); }
  rt::LogRing* events() override { return camera_->events(); }

  void shift(rt::TimeNs by_ns) { shift_ns_ += by_ns; }
  rt::TimeNs shift_ns() const { return shift_ns_; }

 private:
  hal::Camera* const camera_;
  rt::TimeNs shift_ns_ = 0;
};

/// Equal to the bit, which NaN and the signs of zero are not by comparison.
template <std::size_t kSize>
bool same_bits(const std::array<double, kSize>& a, const std::array<double, kSize>& b) {
  for (std::size_t i = 0; i < kSize; ++i) {
    if (std::bit_cast<std::uint64_t>(a[i]) != std::bit_cast<std::uint64_t>(b[i])) return false;
  }
  return true;
}

class AsFlown {
 public:
  AsFlown(hal::Camera* camera, FrameStage* stage, rt::FramePool* pool, const PipelineOptions& options, FrameSink* sink)
      : log_(*options.as_flown),
        options_(options),
        clock_(camera),
        stage_(stage),
        pool_(pool),
        sink_(sink),
        feeder_(&clock_, pool, false, options.onlooker),
        imu_(options.imu, false, nullptr) {}

  rt::Result<PipelineCounters> run(const std::atomic<bool>& stop) {
    // Relaxed: the flag orders nothing, it only ends the loop.
    while (next_ < log_.frames.size() && !stop.load(std::memory_order_relaxed)) {
      const FlownFrame& flown = log_.frames[next_];
      // Sequence numbers go up by one a picture: which comes is known, and one that was not flown takes no slot.
      const bool wanted = seen_ == flown.sequence;
      rt::FrameHandle handle;
      FrameRecord record;
      const Feeder::Outcome outcome = feeder_.read(wanted ? pool_->acquire() : -1, kCameraWaitNs, &handle, &record);
      if (outcome == Feeder::Outcome::kNothing) continue;
      if (outcome == Feeder::Outcome::kEnd)
        return rt::Error{"the pictures end before the flight does, which went on to picture " +
                         std::to_string(log_.frames.back().sequence)};
      if (outcome == Feeder::Outcome::kFrame) {
        ++seen_;
        if (auto r = fly(handle, flown, &record); !r) return r.error();
        ++next_;
      } else {
        if (wanted)
          return rt::Error{"picture " + std::to_string(flown.sequence) +
                           " was flown, and now it is not to be had: " + std::string(record.reason.view())};
        seen_ = record.sequence + 1;
        if (record.fate == FrameFate::kDroppedSlots) {
          record.fate = FrameFate::kDroppedLate;
          record.reason.assign("was not flown then");
        }
      }
      count(record, &counters_);
      if (auto taken = sink_->take(record); !taken) return taken.error();
      if (record.fate != FrameFate::kProcessed) continue;
      if (const auto change = state_.changed(record)) sink_->event(*change);
    }
    if (options_.imu != nullptr) counters_.imu = imu_.counters;
    return counters_;
  }

 private:
  rt::Result<void> fly(rt::FrameHandle handle, const FlownFrame& flown, FrameRecord* record) {
    const std::string which = "picture " + std::to_string(flown.sequence);
    if (handle.meta.sequence != flown.sequence || handle.meta.t_source_ns != flown.t_source_ns)
      return rt::Error{which + " has another time than in the log: these are not the pictures of that flight"};
    const rt::TimeNs off_ns = flown.t_capture_ns - handle.meta.t_capture_ns;
    if (begun_ && off_ns != 0)
      return rt::Error{which +
                       " was captured at another time than in the log: these are not the pictures of that flight"};
    begun_ = true;
    clock_.shift(off_ns);
    handle.meta.t_capture_ns = flown.t_capture_ns;
    pool_->meta(handle.slot) = handle.meta;
    if (auto r = give_boxes(flown, which); !r) return r;
    if (options_.imu == nullptr && flown.order.readings > 0)
      return rt::Error{which + ": there was an inertial sensor in that flight; see --imu"};
    if (!take_readings(flown.order))
      return rt::Error{which + ": the inertial sensor's readings are not those of that flight"};
    {
      const rt::RtScope real_time;
      stage_->expect(flown.order);
      track_frame(stage_, handle, record);
      const rt::TimeNs before = rt::thread_cpu_now_ns();
      while (stage_->map_step()) {
      }
      record->mapper_cpu_ns = rt::thread_cpu_now_ns() - before;
      record->stage_ns[kMapStage] = record->mapper_cpu_ns;
    }
    if (options_.detector != nullptr) pool_->reader(kDetectorReader).give_back(handle.slot);
    compare(flown, *record);
    return {};
  }

  rt::Result<void> give_boxes(const FlownFrame& flown, const std::string& which) {
    if (flown.order.t_detection_ns == 0) return {};
    if (options_.detector == nullptr) return rt::Error{which + ": there was a detector in that flight; see --detector"};
    const FoundBoxes& found = log_.detections.at(flown.order.t_detection_ns);
    options_.detector->give(found);
    sink_->detection(found);
    return {};
  }

  /// As many as then. False: others.
  bool take_readings(const FlownOrder& order) {
    hal::ImuSample sample;
    for (; readings_ < order.readings; ++readings_) {
      auto status = hal::ImuStatus::kEnd;
      do {
        status = imu_.next(&sample, 0);
      } while (status == hal::ImuStatus::kFault);
      if (status != hal::ImuStatus::kSample) return false;
      sample.t_ns += clock_.shift_ns();
      t_reading_ns_ = sample.t_ns;
      stage_->take_imu(sample);
      sink_->reading(sample);
    }
    return t_reading_ns_ == order.t_reading_ns;
  }

  void compare(const FlownFrame& flown, const FrameRecord& record) {
    AsFlownCounters& c = counters_.as_flown;
    const bool found = record.order.room == flown.order.room && record.order.deltas == flown.order.deltas &&
                       record.order.t_detection_ns == flown.order.t_detection_ns;
    if (flown.has_pose) ++c.poses;
    const bool same_pose = !flown.has_pose || (record.has_pose && same_bits(record.t_world_cam, flown.t_world_cam) &&
                                               same_bits(record.q_world_cam, flown.q_world_cam));
    if (found && same_pose) return;
    if (c.unequal++ == 0) c.first_unequal = flown.sequence;
  }

  const FlownLog& log_;
  const PipelineOptions& options_;
  FlownClock clock_;
  FrameStage* const stage_;
  rt::FramePool* const pool_;
  FrameSink* const sink_;
  Feeder feeder_;
  ImuFeeder imu_;
  StateWatch state_;
  PipelineCounters counters_;
  std::size_t next_ = 0;  ///< frame of the log
  std::uint32_t seen_ = 0;
  bool begun_ = false;  ///< the clock is that of the flight
  std::uint64_t readings_ = 0;
  rt::TimeNs t_reading_ns_ = 0;
};

}  // namespace

rt::Result<PipelineCounters> run_as_flown(hal::Camera* camera, FrameStage* stage, rt::FramePool* pool,
                                          const PipelineOptions& options, FrameSink* sink,
                                          const std::atomic<bool>& stop) {
  return AsFlown(camera, stage, pool, options, sink).run(stop);
}

}  // namespace godwit::app
