// What a frame found when it was flown: all that its pose depends on beside its picture and the configuration.
#pragma once

#include <cstdint>

#include "hal/rt/time.h"

namespace godwit::app {

/// Plain data. Known before the frame is tracked, written down with it, and given to a flight that is flown again.
struct FlownOrder {
  std::uint64_t number = 0;       ///< counts the frames that went through the tracker, from 1; 0: this one did not
  std::int32_t room = -1;         ///< messages that the mapper had room for
  std::int32_t deltas = -1;       ///< the mapper's deltas that were taken
  double feature_share = 1.0;     ///< of the features that may be looked for
  rt::TimeNs t_detection_ns = 0;  ///< capture time of the picture whose detection came in with it; 0: none did
  std::uint64_t readings = 0;     ///< of the inertial sensor taken before it, since the beginning
  rt::TimeNs t_reading_ns = 0;    ///< time of the last of them; 0: there was none
};

}  // namespace godwit::app
