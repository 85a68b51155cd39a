// What the autopilot of a simulated flight says of its attitude: off by an angle that wanders, and a little noise.
#pragma once

#include <array>

#include "hal/rt/time.h"
#include "hal/sim/flight/flight.h"
#include "hal/sim/world/random.h"

namespace godwit::sim {

struct AttitudeSample {
  rt::TimeNs t_ns = 0;
  std::array<double, 4> q_ned_body{1, 0, 0,
                                   0};  ///< w x y z, body (front, right, down) to north (the world's x), east, down
};

/// Refers to the flight, which outlives it.
class SimAttitude {
 public:
  SimAttitude(const Flight& flight, rt::TimeNs start_ns);
  /// False: the flight is at its end.
  bool next(AttitudeSample* sample);
  double off_deg() const { return off_deg_; }  ///< the newest sample's vertical

 private:
  const Flight& flight_;
  rt::TimeNs start_ns_;
  Rng rng_;
  std::int64_t index_ = 0;
  Vec3 wander_rad_;  ///< roll, pitch, yaw
  double off_deg_ = 0;
};

}  // namespace godwit::sim
