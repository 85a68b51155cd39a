// A scenario flown with a seed: the world, the aircraft in it, and every sensor behind its interface, with the truth.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "hal/baro/baro.h"
#include "hal/camera/camera.h"
#include "hal/gnss/gnss.h"
#include "hal/range/range.h"
#include "hal/sim/flight/scenario.h"

namespace godwit::sim {

class Flight;
class SimBarometer;  // hal/sim/flight/sim_baro.h

/// The simulated camera. Renders when asked, never waits: the caller paces.
class SimCamera final : public hal::Camera {
 public:
  SimCamera(const Flight& flight, rt::TimeNs start_ns);
  int width() const override;
  int height() const override;
  int channels() const override { return 1; }
  /// A picture that the scenario drops is a kBadFrame; `why` says so. Into an empty view nothing is
  /// written; those after it are the same.
  hal::CameraStatus next(const rt::MutableImageView& grey, std::uint8_t* bgr, rt::TimeNs timeout_ns,
                         hal::CapturedFrame* frame, std::string* why) override;
  /// Number of pictures that are due over the flight.
  int frames() const;
  /// Leaves out the pictures before this one, unrendered.
  void skip_to(int index) { index_ = index; }

  // Truth of the newest picture.
  double t_s() const { return t_s_; }
  const Renderer& scene() const { return renderer_; }
  double gain() const { return sensor_.gain(); }

 private:
  bool dropped(int index) const;

  const Flight& flight_;
  rt::TimeNs start_ns_;
  Renderer renderer_;
  Sensor sensor_;
  int index_ = 0;
  double t_s_ = 0;
};

/// Distance along the body's down axis to the ground or the roof below.
class SimRangefinder final : public hal::Rangefinder {
 public:
  SimRangefinder(const Flight& flight, rt::TimeNs start_ns);
  hal::RangeStatus next(hal::RangeSample* sample, rt::TimeNs timeout_ns) override;
  double truth_m() const { return truth_m_; }  ///< of the newest sample; infinite where nothing is below

 private:
  const Flight& flight_;
  rt::TimeNs start_ns_;
  Rng rng_;
  std::int64_t index_ = 0;
  double truth_m_ = 0;
};

class SimGnss final : public hal::Gnss {
 public:
  SimGnss(const Flight& flight, rt::TimeNs start_ns);
  hal::GnssStatus next(hal::GnssSample* sample, rt::TimeNs timeout_ns) override;

 private:
  const Flight& flight_;
  rt::TimeNs start_ns_;
  Rng rng_;
  std::int64_t index_ = 0;
  Vec3 wander_ = Vec3::Zero();
};

/// Immutable; its sensors refer to it and must not outlive it.
class Flight {
 public:
  Flight(const Scenario& scenario, std::uint64_t seed);
  Flight(const Flight&) = delete;
  Flight& operator=(const Flight&) = delete;

  const Scenario& scenario() const { return scenario_; }
  std::uint64_t seed() const { return seed_; }
  const World& world() const { return world_; }
  const Trajectory& trajectory() const { return trajectory_; }
  double duration_s() const;
  /// Capture time of picture `index`, seconds from the start.
  double frame_time_s(int index) const { return index / scenario_.camera.fps; }

  // start_ns: what the flight's second 0 is on CLOCK_MONOTONIC.
  std::unique_ptr<SimCamera> camera(rt::TimeNs start_ns) const;
  std::unique_ptr<SimImu> imu(rt::TimeNs start_ns) const;
  std::unique_ptr<SimRangefinder> rangefinder(rt::TimeNs start_ns) const;  ///< null where the scenario has none
  std::unique_ptr<SimGnss> gnss(rt::TimeNs start_ns) const;                ///< null where the scenario has none
  std::unique_ptr<SimBarometer> barometer(rt::TimeNs start_ns) const;      ///< null where the scenario has none

 private:
  Scenario scenario_;
  std::uint64_t seed_;
  World world_;
  Trajectory trajectory_;
};

/// Flies the whole way in thought: an error if the aircraft would hit the ground or a building.
rt::Result<void> check_clearance(const Flight& flight);

}  // namespace godwit::sim
