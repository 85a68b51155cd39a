// One interface to barometers: the autopilot's, through the bus, or simulation.
#pragma once

#include <cstdint>

#include "hal/rt/time.h"

namespace godwit::hal {

/// One reading of the static pressure.
struct BaroSample {
  rt::TimeNs t_ns = 0;
  double pressure_pa = 0;
};

enum class BaroStatus : std::uint8_t { kSample, kTimeout, kEnd };

/// A source of samples in the order of their times. One thread calls it. No allocation in next.
class Barometer {
 public:
  virtual ~Barometer() = default;
  virtual BaroStatus next(BaroSample* sample, rt::TimeNs timeout_ns) = 0;
};

}  // namespace godwit::hal
