// A real odometry on pictures of the simulated world, rendered once for a test program, and what the tests ask of it.
#pragma once

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <gtest/gtest.h>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "firmware_app/pipeline/odometry_stage.h"
#include "firmware_app/pipeline/pipeline.h"
#include "firmware_app/sim/flight_calibration.h"
#include "firmware_app/sim/looped_pictures.h"
#include "hal/rt/wake_up.h"

namespace godwit::test {

/// The street at 640 x 480, 30 frames a second.
struct World {
  std::unique_ptr<sim::Flight> flight;
  hal::CameraCalibration calibration;
};

inline const World& world() {
  static const World made = [] {
    World w;
    const auto scenario = sim::find_scenario("street", GODWIT_SCENARIO_DIR);
    if (!scenario) {
      ADD_FAILURE() << scenario.error().message;
      std::abort();
    }
    w.flight = std::make_unique<sim::Flight>(scenario.value(), 1);
    w.calibration = app::calibration_of(*w.flight);
    return w;
  }();
  return made;
}

/// Every third picture of the flight's beginning, as if it flew at 9 m/s: few pictures with room between them.
class Strides final : public hal::Camera {
 public:
  explicit Strides(std::unique_ptr<sim::SimCamera> all) : all_(std::move(all)) {}
  int width() const override { return all_->width(); }
  int height() const override { return all_->height(); }
  int channels() const override { return 1; }
  hal::CameraStatus next(const rt::MutableImageView& grey, std::uint8_t* bgr, rt::TimeNs timeout_ns,
                         hal::CapturedFrame* frame, std::string* why) override {
    all_->skip_to(3 * number_++);
    return all_->next(grey, bgr, timeout_ns, frame, why);
  }

 private:
  std::unique_ptr<sim::SimCamera> all_;
  int number_ = 0;
};

/// The flight, forth and back; rendered at the first call.
inline std::unique_ptr<app::LoopedPictures> camera_of(const app::LoopedPictures::Options& options) {
  static const std::unique_ptr<app::LoopedPictures> made = [] {
    constexpr int kPictures = 20;
    Strides source(world().flight->camera(0));
    const std::atomic<bool> stop{false};
    auto camera = app::LoopedPictures::record(&source, kPictures, {}, stop);
    if (!camera) std::abort();
    return std::move(camera).value();
  }();
  return made->again(options);
}

/// 200 readings a second of a body at rest, but none for a while.
class RestingImu final : public hal::Imu {
 public:
  rt::TimeNs mute_from_ns = 0, mute_to_ns = 0;  ///< counted from the first call
  double rate_hz() const override { return 200; }
  hal::ImuStatus next(hal::ImuSample* sample, rt::TimeNs timeout_ns) override {
    const rt::TimeNs now = rt::monotonic_now_ns();
    if (start_ns_ == 0) due_ns_ = start_ns_ = now;
    if (due_ns_ >= start_ns_ + mute_from_ns && due_ns_ < start_ns_ + mute_to_ns) due_ns_ = start_ns_ + mute_to_ns;
    rt::sleep_until_ns(std::min(due_ns_, now + timeout_ns));
    if (due_ns_ > now + timeout_ns) return hal::ImuStatus::kTimeout;
    sample->t_ns = due_ns_;
    sample->accel_m_s2 = {0, 0, -9.81};
    due_ns_ += 5 * rt::kNsPerMs;
    return hal::ImuStatus::kSample;
  }

 private:
  rt::TimeNs start_ns_ = 0, due_ns_ = 0;
};

/// Pool and stage for the street's camera.
struct Odometry {
  explicit Odometry(bool with_detector = false, bool inertial = false, bool onlooker = false,
                    app::FrameView* view = nullptr) {
    rt::FramePool::Layout layout;
    layout.width = world().calibration.width;
    layout.height = world().calibration.height;
    layout.pyramid_bytes = app::odometry_pyramid_bytes(layout.width, layout.height);
    layout.slots = app::odometry_frame_slots() + (with_detector ? app::kDetectorSlots : 0);
    layout.readers = with_detector ? app::kFrameReadersWithDetector : app::kFrameReaders;
    layout.onlooker = onlooker;
    if (onlooker) layout.slots += app::kOnlookerSlots;
    pool = std::move(rt::FramePool::create(layout)).value();
    auto model = app::make_camera_model(world().calibration);
    app::OdometryOptions options = app::odometry_options(world().calibration);
    if (inertial) options.inertial_T_body_cam = world().calibration.T_body_cam;
    stage = app::make_odometry_stage(model.value(), options, pool.get(), nullptr, view);
  }
  std::unique_ptr<rt::FramePool> pool;
  std::unique_ptr<app::FrameStage> stage;
};

/// Keeps all records and events; room is taken before the flight.
class Notes : public app::FrameSink {
 public:
  explicit Notes(std::size_t frames) { records.reserve(frames + 1000); }
  rt::Result<void> take(const app::FrameRecord& record) override {
    records.push_back(record);
    return {};
  }
  void event(const rt::LogEntry& entry) override { events.push_back(entry); }
  /// The first event of this name; null: there was none.
  const rt::LogEntry* find(std::string_view what) const {
    for (const rt::LogEntry& e : events) {
      if (what == e.what) return &e;
    }
    return nullptr;
  }
  bool heard(std::string_view what) const { return find(what) != nullptr; }
  std::vector<app::FrameRecord> records;
  std::vector<rt::LogEntry> events;
};

/// A whole number from the environment, for longer runs by hand.
inline int from_environment(const char* name, int otherwise) {
  const char* const text = std::getenv(name);
  return text != nullptr ? std::atoi(text) : otherwise;
}

/// Resident memory of this process now [kB].
inline long resident_kb() {
  std::ifstream status("/proc/self/status");
  std::string word;
  long kb = 0;
  while (status >> word) {
    if (word == "VmRSS:") status >> kb;
  }
  return kb;
}

}  // namespace godwit::test
