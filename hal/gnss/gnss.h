// One interface to satellite positions: the autopilot's, through the bus, or simulation.
#pragma once

#include <array>
#include <cstdint>

#include "hal/rt/time.h"

namespace godwit::hal {

/// One fix in a local frame with z up, whose origin the source chooses and keeps.
struct GnssSample {
  rt::TimeNs t_ns = 0;
  std::array<double, 3> position_m{};
  std::array<double, 3> velocity_m_s{};
  double sigma_position_m = 0;    ///< one sigma of each axis
  double sigma_velocity_m_s = 0;  ///< the same; 0: not told
  bool fix = false;               ///< false: no satellites; position and velocity then mean nothing
};

enum class GnssStatus : std::uint8_t { kSample, kTimeout, kEnd };

/// A source of samples in the order of their times. One thread calls it. No allocation in next.
class Gnss {
 public:
  virtual ~Gnss() = default;
  virtual GnssStatus next(GnssSample* sample, rt::TimeNs timeout_ns) = 0;
};

}  // namespace godwit::hal
