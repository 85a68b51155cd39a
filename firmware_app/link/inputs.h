// What the autopilot and other nodes tell us, handed to the pipeline with arrival and source time. This is all that can
// reach the odometry from the bus.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "firmware_app/link/dronecan/transfer.h"
#include "firmware_app/link/mavlink/codec.h"
#include "hal/rt/spsc_ring.h"
#include "hal/rt/time.h"

namespace godwit::link {

enum class InputKind : std::uint8_t {
  kAttitude,        ///< value: quaternion w x y z (body FRD to NED), rates FRD [rad/s]
  kImu,             ///< value: acceleration FRD [m/s^2], rates FRD [rad/s]
  kRange,           ///< value: distance [m], orientation (MAV_SENSOR_ORIENTATION, or below), smallest, largest [m]
  kLocalPosition,   ///< value: position NED [m], velocity NED [m/s]
  kGlobalPosition,  ///< value: latitude, longitude [degree], altitude, height above home [m], velocity NED [m/s]
  kPressure,        ///< value: pressure [Pa], variance [Pa^2], 0: not told
  /// A receiver's own: latitude, longitude [degree], height [m], fix as in MAVLink, sigma level, up [m]; velocity east,
  /// north [m/s], and the sigma of both, 0: not told.
  kSatellites,
  kArmed,   ///< value: 0 or 1
  kBusTime  ///< value: none; t_source_us: time of the bus master's previous GlobalTimeSync
};

/// Orientations of a rangefinder.
constexpr double kLooksDown = 25, kLooksUnknown = -1, kLooksElsewhere = -2;
/// MAV_SENSOR GPS_FIX_TYPE from which on there is a place in three dimensions, and the last that is known (PPP).
constexpr double kFix3d = 3, kFixBest = 8;

struct AutopilotInput {
  InputKind kind = InputKind::kArmed;
  bool from_autopilot = false;    ///< by MAVLink; else by a node of the bus for itself
  std::uint8_t source = 0;        ///< node id on the bus, or MAVLink component
  std::uint8_t sensor = 0;        ///< id of the sensor, where there are several
  rt::TimeNs t_arrival_ns = 0;    ///< CLOCK_MONOTONIC
  std::uint64_t t_source_us = 0;  ///< the source's own clock, 0: not given
  rt::TimeNs t_measured_ns = 0;   ///< t_source on our clock by TIMESYNC, 0: not known
  std::array<double, 9> value{};
};

using InputRing = rt::SpscRing<AutopilotInput, 512>;

/// The reader's side: the oldest that waits; false where nothing does. A ring that is full had no room for what came
/// since: what waits in it is old, and is passed over.
inline bool take_input(InputRing* ring, AutopilotInput* input) {
  if (ring->size() == InputRing::capacity()) {
    for (std::size_t i = 0; i < InputRing::capacity(); ++i) ring->try_pop(input);
  }
  return ring->try_pop(input);
}

/// Reads a MAVLink message as an input; false where it is none, or holds a number that is not finite.
bool input_from_mavlink(const mavlink::RawMessage& raw, AutopilotInput* out);

/// The same for a DroneCAN message: Range 1050, StaticPressure 1028, Fix2 1063, RawIMU 1003, GlobalTimeSync 4.
bool input_from_dronecan(const dronecan::Transfer& transfer, AutopilotInput* out);

}  // namespace godwit::link
