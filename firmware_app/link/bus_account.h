// What sending costs: how old poses are when they are out, the load of the bus, what was lost on the way.
#pragma once

#include <cstdint>

#include "firmware_app/link/latency.h"
#include "firmware_app/link/pose_departure.h"
#include "firmware_app/link/tx_queue.h"

namespace godwit::link {

/// A pose given to queue or port.
struct SentPose {
  rt::TimeNs t_capture_ns = 0;
  rt::TimeNs t_published_ns = 0;  ///< 0: not known, or it is none of a frame
  std::int8_t quality = -1;
  std::uint64_t number = 0;  ///< of its message in the queue
};

/// The way of a message from us to the autopilot.
struct Wire {
  bool synchronised = false;     ///< by TIMESYNC
  rt::TimeNs round_trip_ns = 0;  ///< the smallest one
  double line_baud = 0;          ///< of the serial line in the bus' place [bit/s]; 0: there is none
  bool tunnel = false;           ///< through the bus
  double bus_bit_rate = 0;       ///< [bit/s], 0: not known
  double pose_bits = 0;          ///< of the last pose on the bus, with stuffing
  double tunnel_baud = 0;        ///< that the tunnel names [bit/s]
};

/// What of that way is not in our own clock.
LatencyPath path_over(const Wire& wire);

/// The figures of the last second.
struct BusFigures {
  LatencySummary latency;
  std::size_t own_samples = 0;
  double own_p50_ms = 0, own_p99_ms = 0, own_max_ms = 0;
  double load_percent = 0;
  bool trouble = false;
};

/// One thread; no allocation.
class BusAccount {
 public:
  void given(const SentPose& pose) {
    pose_ = pose;
    under_way_ = true;
  }
  /// Whether the pose given last has just left: all of it, where the newest pose that left has this number. True once.
  bool left(std::uint64_t newest_number_sent);
  /// The same on a port, where what is given is out.
  bool left() { return left(pose_.number); }
  /// After left(): when its last frame was handed over. Returns what whoever measures is told; capture time 0: nothing.
  PoseDeparture account(rt::TimeNs t_sent_ns, const LatencyPath& path);

  /// Once a second. bit_rate: of the bus. gone: bus or port is off or gone.
  const BusFigures& each_second(const TxCounters& tx, double bit_rate, bool gone);
  const BusFigures& figures() const { return figures_; }

 private:
  SentPose pose_;
  bool under_way_ = false;
  LatencyMonitor latency_;
  TimeWindow own_time_;  ///< from a pose given to the link to its last frame
  double bits_before_ = 0;
  std::uint64_t drops_before_ = 0;
  BusFigures figures_;
};

}  // namespace godwit::link
