// How busy a flight was when a frame was done: what waited for whom, what the ladder had shed.
#pragma once

#include <cstdint>

#include "firmware_app/scheduler/scheduler.h"
#include "hal/rt/time.h"

namespace godwit::app {

/// Plain data. As this frame found it: what follows from the frame itself stands in the next one's. Counters count from
/// the start of the flight.
struct LoadRecord {
  bool known = false;  ///< false: one thread flew, where nothing waits and nothing is shed
  Rung rung = Rung::kFull;
  std::uint64_t slips = 0;  ///< poses that stood too late
  std::uint64_t detections = 0, detections_failed = 0, detections_late = 0, detector_stuck = 0;
  std::uint64_t keyframes_undetected = 0;
  rt::TimeNs mask_age_ns = -1;                    ///< negative: there was no mask yet
  std::int32_t frames_waiting = 0;                ///< for the tracker
  std::int32_t readings_waiting = 0;              ///< of the inertial sensor, the same
  std::int32_t mapper_backlog = 0;                ///< messages
  std::int32_t records_waiting = 0;               ///< for files, log and link's words
  std::int32_t slots_free = 0, slots_fewest = 0;  ///< of the frame pool: now, and at any time so far
  std::uint64_t records_lost = 0, events_lost = 0;
};

}  // namespace godwit::app
