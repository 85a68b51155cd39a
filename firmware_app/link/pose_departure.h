// When poses left for the autopilot, for whoever measures it.
#pragma once

#include "hal/rt/spsc_ring.h"
#include "hal/rt/time.h"

namespace godwit::link {

/// One pose of a frame whose message is out: its last frame was handed to the bus, or its bytes to the port.
struct PoseDeparture {
  rt::TimeNs t_capture_ns = 0;
  rt::TimeNs t_sent_ns = 0;
};

/// Link thread -> a thread that measures. What finds it full is not kept: sending does not wait for measuring.
using DepartureRing = rt::SpscRing<PoseDeparture, 256>;

}  // namespace godwit::link
