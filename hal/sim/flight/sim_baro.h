// The barometer of a simulated flight: standard atmosphere, noise, weather that wanders, and a hole that is not quite
// static.
#pragma once

#include "hal/baro/baro.h"
#include "hal/sim/flight/flight.h"
#include "hal/sim/world/random.h"

namespace godwit::sim {

/// Pressure of the standard atmosphere (ICAO Doc 7488, troposphere) at a height above the sea [Pa]. The simulated
/// world's z = 0 lies at the sea.
double standard_pressure_pa(double height_m);

/// Refers to the flight, which outlives it.
class SimBarometer final : public hal::Barometer {
 public:
  SimBarometer(const Flight& flight, rt::TimeNs start_ns);
  hal::BaroStatus next(hal::BaroSample* sample, rt::TimeNs timeout_ns) override;
  double truth_pa() const { return truth_pa_; }  ///< undisturbed, of the newest sample

 private:
  const Flight& flight_;
  rt::TimeNs start_ns_;
  Rng rng_;
  std::int64_t index_ = 0;
  double truth_pa_ = 0, wander_pa_ = 0, lagged_pa_ = 0;
};

}  // namespace godwit::sim
