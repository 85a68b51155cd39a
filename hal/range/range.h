// One interface to rangefinders: the autopilot's, through the bus, or simulation.
#pragma once

#include <cstdint>

#include "hal/rt/time.h"

namespace godwit::hal {

/// One distance along the sensor's axis, which points along the body's z (down) unless the mounting says otherwise.
struct RangeSample {
  rt::TimeNs t_ns = 0;
  double range_m = 0;
  bool valid = false;  ///< false: out of range or no echo; range_m then means nothing
};

enum class RangeStatus : std::uint8_t { kSample, kTimeout, kEnd };

/// A source of samples in the order of their times. One thread calls it. No allocation in next.
class Rangefinder {
 public:
  virtual ~Rangefinder() = default;
  virtual RangeStatus next(RangeSample* sample, rt::TimeNs timeout_ns) = 0;
};

}  // namespace godwit::hal
