#include "hal/sim/flight/flight.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "hal/sim/flight/sim_baro.h"

namespace godwit::sim {

Flight::Flight(const Scenario& scenario, std::uint64_t seed)
    : scenario_(scenario),
      seed_(seed),
      world_(scenario.world, seed),
      trajectory_(scenario.trajectory,
                  world_.terrain().height(scenario.trajectory.start_m.x(), scenario.trajectory.start_m.y()), seed) {}

double Flight::duration_s() const {
  return std::min(trajectory_.duration_s(), scenario_.max_duration_s);
}

std::unique_ptr<SimCamera> Flight::camera(rt::TimeNs start_ns) const {
  return std::make_unique<SimCamera>(*this, start_ns);
}
std::unique_ptr<SimImu> Flight::imu(rt::TimeNs start_ns) const {
  return std::make_unique<SimImu>(trajectory_, scenario_.imu, start_ns, seed_);
}
std::unique_ptr<SimRangefinder> Flight::rangefinder(rt::TimeNs start_ns) const {
  return scenario_.range.present ? std::make_unique<SimRangefinder>(*this, start_ns) : nullptr;
}
std::unique_ptr<SimGnss> Flight::gnss(rt::TimeNs start_ns) const {
  return scenario_.gnss.present ? std::make_unique<SimGnss>(*this, start_ns) : nullptr;
}

std::unique_ptr<SimBarometer> Flight::barometer(rt::TimeNs start_ns) const {
  return scenario_.baro.present ? std::make_unique<SimBarometer>(*this, start_ns) : nullptr;
}

SimCamera::SimCamera(const Flight& flight, rt::TimeNs start_ns)
    : flight_(flight),
      start_ns_(start_ns),
      renderer_(flight.world(), flight.trajectory(), flight.scenario().camera.rig),
      sensor_(flight.scenario().sensor, flight.scenario().camera.rig, flight.world().sun(), flight.seed()) {}

int SimCamera::width() const {
  return flight_.scenario().camera.rig.lens.width;
}
int SimCamera::height() const {
  return flight_.scenario().camera.rig.lens.height;
}
int SimCamera::frames() const {
  return static_cast<int>(flight_.duration_s() * flight_.scenario().camera.fps);
}

bool SimCamera::dropped(int index) const {
  const CameraFaults& faults = flight_.scenario().faults;
  const double t = flight_.frame_time_s(index);
  if (faults.gap_s > 0 && t >= faults.gap_every_s && std::fmod(t, faults.gap_every_s) < faults.gap_s) return true;
  return Rng(flight_.seed() ^ 0xd20bULL, static_cast<std::uint64_t>(index)).uniform() < faults.drop_share;
}

hal::CameraStatus SimCamera::next(const rt::MutableImageView& grey, std::uint8_t*, rt::TimeNs,
                                  hal::CapturedFrame* frame, std::string* why) {
  if (index_ >= frames()) return hal::CameraStatus::kEnd;
  const int index = index_++;
  t_s_ = flight_.frame_time_s(index);
  const double told_s = t_s_ + flight_.scenario().camera.time_offset_ms * 1e-3;
  frame->t_source_ns = static_cast<rt::TimeNs>(std::llround(told_s * 1e9));
  frame->t_capture_ns = start_ns_ + frame->t_source_ns;
  frame->sequence = static_cast<std::uint32_t>(index);
  if (dropped(index)) {
    if (why != nullptr) *why = "dropped by the scenario";
    return hal::CameraStatus::kBadFrame;
  }
  // No room: passed over. What comes after it must not hang on that: the flight that is flown again passes over others.
  const bool taken = grey.data != nullptr;
  if (!taken && !flight_.scenario().sensor.auto_exposure) return hal::CameraStatus::kFrame;
  renderer_.render(t_s_);
  if (!taken) {
    sensor_.control(renderer_, t_s_);
    return hal::CameraStatus::kFrame;
  }
  sensor_.expose(renderer_, t_s_, frame->sequence, grey);
  return hal::CameraStatus::kFrame;
}

SimRangefinder::SimRangefinder(const Flight& flight, rt::TimeNs start_ns)
    : flight_(flight), start_ns_(start_ns), rng_(flight.seed(), 0x4a9e) {}

hal::RangeStatus SimRangefinder::next(hal::RangeSample* sample, rt::TimeNs) {
  const RangePlan& plan = flight_.scenario().range;
  const double t = static_cast<double>(index_++) / plan.rate_hz;
  if (t > flight_.duration_s()) return hal::RangeStatus::kEnd;
  const BodyState body = flight_.trajectory().at(t);
  const Vec3 down = body.R_world_body.col(2);
  // Walk along the beam until below a surface, then halve.
  constexpr double kStep = 0.25;
  truth_m_ = std::numeric_limits<double>::infinity();
  const auto above = [&](double s) {
    const Vec3 p = body.position_m + s * down;
    return p.z() > flight_.world().surface_height(p.x(), p.y());
  };
  for (double s = kStep; s < plan.max_m + kStep; s += kStep) {
    if (above(s)) continue;
    double low = s - kStep, high = s;
    for (int i = 0; i < 20; ++i) (above((low + high) / 2) ? low : high) = (low + high) / 2;
    truth_m_ = high;
    break;
  }
  double reading = truth_m_ + plan.noise_m * rng_.gaussian();
  for (const RangeJump& jump : plan.jumps) {
    if (t >= jump.t_s && t < jump.t_s + jump.duration_s) reading += jump.offset_m;
  }
  const bool lost = rng_.uniform() < plan.dropout_share;
  sample->t_ns = start_ns_ + static_cast<rt::TimeNs>(std::llround(t * 1e9));
  sample->valid = !lost && reading >= plan.min_m && reading <= plan.max_m;
  sample->range_m = sample->valid ? reading : 0;
  return hal::RangeStatus::kSample;
}

SimGnss::SimGnss(const Flight& flight, rt::TimeNs start_ns)
    : flight_(flight), start_ns_(start_ns), rng_(flight.seed(), 0x6155) {}

hal::GnssStatus SimGnss::next(hal::GnssSample* sample, rt::TimeNs) {
  const GnssPlan& plan = flight_.scenario().gnss;
  const double dt = 1 / plan.rate_hz, t = static_cast<double>(index_++) * dt;
  if (t > flight_.duration_s()) return hal::GnssStatus::kEnd;
  constexpr double kVelocitySigma = 0.05;  // u-blox NEO-M8, data sheet
  // Errors of satellite positions wander slowly: 30 s here, and the height is twice as bad.
  const double decay = std::exp(-dt / 30), kick = index_ == 1 ? 1 : std::sqrt(1 - decay * decay);
  const BodyState body = flight_.trajectory().at(t);
  *sample = {};
  sample->t_ns = start_ns_ + static_cast<rt::TimeNs>(std::llround(t * 1e9));
  for (int i = 0; i < 3; ++i) {
    const double sigma = plan.sigma_m * (i == 2 ? 2 : 1);
    wander_[i] = (index_ == 1 ? 0 : decay) * wander_[i] + kick * sigma * rng_.gaussian();
    const double velocity_noise = kVelocitySigma * rng_.gaussian();
    if (t >= plan.lost_after_s) continue;
    sample->position_m[i] = body.position_m[i] + wander_[i];
    sample->velocity_m_s[i] = body.velocity_m_s[i] + velocity_noise;
  }
  sample->sigma_position_m = plan.sigma_m;
  sample->sigma_velocity_m_s = kVelocitySigma;
  sample->fix = t < plan.lost_after_s;
  return hal::GnssStatus::kSample;
}

rt::Result<void> check_clearance(const Flight& flight) {
  const auto told = [&](double t, const std::string& what, const Vec3& p) {
    return rt::Error{"scenario " + flight.scenario().name + ", seed " + std::to_string(flight.seed()) + ": at " +
                     std::to_string(t) + " s the aircraft would be " + what + " at (" + std::to_string(p.x()) + ", " +
                     std::to_string(p.y()) + ")"};
  };
  Vec3 before = flight.trajectory().at(0).position_m;
  for (double t = 0; t < flight.duration_s(); t += 0.1) {
    const Vec3 p = flight.trajectory().at(t).position_m;
    const double below = flight.world().surface_height(p.x(), p.y());
    if (p.z() < below + 0.1) return told(t, std::to_string(below - p.z()) + " m below what stands", p);
    if (flight.world().way_is_barred(before, p)) return told(t, "in the middle of something thin", p);
    before = p;
  }
  return {};
}

}  // namespace godwit::sim
