// What one flight of the latency benchmark measured. Plain data; report.h makes tables and JSON of it.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "firmware_app/pipeline/frame_record.h"

namespace godwit::bench {

/// Distribution of one time [ms]; all zero for no values. Percentiles interpolate linearly between neighbours.
struct Distribution {
  std::size_t samples = 0;
  double p50 = 0, p95 = 0, p99 = 0, p999 = 0, max = 0, mean = 0;
};
Distribution distribution_of(std::vector<double> values);

/// How a simulated camera delays its pictures [ms]; capture time is the middle of the exposure of the middle row.
struct CameraDelays {
  double exposure_ms = 0, readout_ms = 0, transfer_ms = 0;
  /// From capture time to delivery: the second half of exposure and readout, then the transfer.
  double delivery_ms() const { return exposure_ms / 2 + readout_ms / 2 + transfer_ms; }
};

/// What one thread used while the frames were flown.
struct ThreadUse {
  std::string name;
  double cpu_percent = 0;          ///< of one processor
  std::uint64_t waits = 0;         ///< context switches that it wanted (voluntary)
  std::uint64_t preemptions = 0;   ///< and that it did not (involuntary)
  std::int64_t minor_faults = -1;  ///< page faults after arming; -1: not measured for this thread
  std::int64_t major_faults = -1;  ///< the same
  std::int64_t allocations = -1;   ///< heap operations in its real-time parts; -1: not measured for this thread
};

/// A flight with the detector on or off.
struct FlightFigures {
  bool detector = false;
  double seconds = 0;  ///< from the first picture's delivery to the last one's pose
  std::uint64_t due = 0, processed = 0, tracked = 0, bad = 0, dropped = 0;
  std::uint64_t missed_deadlines = 0;  ///< poses that stood later than one camera interval after delivery
  double deadline_ms = 0;
  std::int64_t first_pose_frames = -1;  ///< pictures before the first pose; -1: there was none
  double first_pose_ms = -1;            ///< from the first picture's capture to the first pose's
  double poses_hz = 0;                  ///< tracked poses a second of flight
  Distribution age_at_pose;             ///< from mid-exposure to the pose
  Distribution delivery;                ///< from mid-exposure to the picture in our memory, as it was
  Distribution own_at_pose;             ///< the same from delivery: our own share
  Distribution age_at_bus;  ///< from mid-exposure to the pose's last frame handed to the bus; no samples: no bus
  Distribution own_at_bus;
  Distribution tracker_cpu;                   ///< thread CPU time of the tracking call, pyramid included
  std::array<Distribution, 2> detection_cpu;  ///< thread CPU time of a detection of full input, and of small
  std::array<Distribution, app::kStages> stages{};
  std::uint64_t detections = 0, detections_failed = 0, detections_late = 0;
  std::string rung;  ///< of the scheduler's ladder, at the end
  std::vector<ThreadUse> threads;
  double resident_mb = 0, peak_mb = 0, locked_mb = 0,
         pictures_mb = 0;  ///< MB = 10^6 bytes; pictures: held by the camera
  std::string refused;     ///< real-time rights that the machine refused, in words; empty: none
  // For the plot: one a tracked frame.
  std::vector<float> t_s, age_ms, own_ms;
};

}  // namespace godwit::bench
