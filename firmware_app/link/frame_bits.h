// How long a CAN frame occupies the bus.
#pragma once

#include "hal/can/can_frame.h"

namespace godwit::link {

/// Bits of a classic frame on the wire with its own stuff bits (ISO 11898-1: identifier to CRC are stuffed),
/// delimiters, acknowledge, end of frame and the pause of 3 bits. For CAN FD: the nominal bits of the arbitration phase
/// plus those of the data phase divided by data_rate_factor (data bit rate / nominal bit rate), stuffing taken at its
/// mean. No allocation.
double frame_bits(const hal::CanFrame& frame, double data_rate_factor = 1);

}  // namespace godwit::link
