#include "firmware_app/sim/flight_aids.h"

#include <algorithm>

#include "hal/sim/flight/sim_attitude.h"
#include "hal/sim/flight/sim_baro.h"
#include "hal/sim/sensors/sensor.h"

namespace godwit::app {

hal::AidRecord aid_record_of(const sim::Flight& flight, const std::vector<hal::AidKind>& kinds) {
  hal::AidRecord all;
  const auto wanted = [&](hal::AidKind kind) { return std::find(kinds.begin(), kinds.end(), kind) != kinds.end(); };
  if (const auto range = flight.rangefinder(0); range && wanted(hal::AidKind::kRange)) {
    hal::RangeSample s;
    while (range->next(&s, 0) == hal::RangeStatus::kSample) {
      if (s.valid) all.push_back({hal::AidKind::kRange, s.t_ns, {0, 0, s.range_m}, hal::kRangeSigmaM});
    }
  }
  if (const auto baro = flight.barometer(0); baro && wanted(hal::AidKind::kBarometer)) {
    hal::BaroSample s;
    while (baro->next(&s, 0) == hal::BaroStatus::kSample)
      all.push_back(
          {hal::AidKind::kBarometer, s.t_ns, {0, 0, hal::pressure_height_m(s.pressure_pa)}, hal::kPressureSigmaM});
  }
  if (const auto gnss = flight.gnss(0); gnss && wanted(hal::AidKind::kSatellites)) {
    hal::GnssSample s;
    while (gnss->next(&s, 0) == hal::GnssStatus::kSample) {
      const std::array<double, 2> level = {s.velocity_m_s[0], s.velocity_m_s[1]};
      if (s.fix)
        all.push_back(
            {hal::AidKind::kSatellites, s.t_ns, s.position_m, s.sigma_position_m, level, s.sigma_velocity_m_s});
    }
  }
  if (wanted(hal::AidKind::kAttitude)) {
    sim::SimAttitude attitude(flight, 0);
    sim::AttitudeSample s;
    while (attitude.next(&s))
      all.push_back({hal::AidKind::kAttitude, s.t_ns, hal::up_of_attitude(s.q_ned_body), hal::kAttitudeSigmaRad});
  }
  std::stable_sort(all.begin(), all.end(),
                   [](const hal::AidSample& a, const hal::AidSample& b) { return a.t_ns < b.t_ns; });
  return all;
}

}  // namespace godwit::app
