#include "hal/sim/flight/sim_baro.h"

#include <cmath>

namespace godwit::sim {

double standard_pressure_pa(double height_m) {
  return 101325.0 * std::pow(1 - 2.25577e-5 * height_m, 5.25588);
}

SimBarometer::SimBarometer(const Flight& flight, rt::TimeNs start_ns)
    : flight_(flight), start_ns_(start_ns), rng_(flight.seed(), 0xba40) {
  wander_pa_ = flight.scenario().baro.wander_pa * rng_.gaussian();
}

hal::BaroStatus SimBarometer::next(hal::BaroSample* sample, rt::TimeNs) {
  const BaroPlan& plan = flight_.scenario().baro;
  const double dt = 1 / plan.rate_hz, t = static_cast<double>(index_) * dt;
  if (t > flight_.duration_s()) return hal::BaroStatus::kEnd;
  const BodyState body = flight_.trajectory().at(t);
  truth_pa_ = standard_pressure_pa(body.position_m.z());
  constexpr double kAirDensity = 1.225;
  const double seen = truth_pa_ - plan.dynamic_share * 0.5 * kAirDensity * body.velocity_m_s.squaredNorm();
  const double lag = plan.delay_ms > 0 && index_ > 0 ? std::exp(-1e3 * dt / plan.delay_ms) : 0;
  lagged_pa_ = lag * lagged_pa_ + (1 - lag) * seen;
  if (index_ > 0) {
    const double keep = std::exp(-dt / plan.wander_s);
    wander_pa_ = keep * wander_pa_ + plan.wander_pa * std::sqrt(1 - keep * keep) * rng_.gaussian();
  }
  sample->t_ns = start_ns_ + static_cast<rt::TimeNs>(std::llround(t * 1e9));
  sample->pressure_pa = lagged_pa_ + wander_pa_ + plan.noise_pa * rng_.gaussian();
  ++index_;
  return hal::BaroStatus::kSample;
}

}  // namespace godwit::sim
