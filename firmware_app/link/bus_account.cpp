#include "firmware_app/link/bus_account.h"

#include <algorithm>

namespace godwit::link {
namespace {
constexpr double kTimesyncBits = 4 * 135;  // a TIMESYNC of 28 bytes through the tunnel
constexpr double kTimesyncBytes = 28;
constexpr double kPoseBytes = 245;
constexpr double kLineBitsPerByte = 10;
}  // namespace

LatencyPath path_over(const Wire& wire) {
  LatencyPath path;
  if (wire.synchronised) path.one_way_ns = wire.round_trip_ns / 2;
  // Half a round trip holds a TIMESYNC's way along the wire; a pose is longer.
  if (wire.line_baud > 0) {
    path.wire_extra_ns =
        static_cast<rt::TimeNs>((kPoseBytes - kTimesyncBytes) * kLineBitsPerByte / wire.line_baud * 1e9);
  }
  if (!wire.tunnel) return path;
  if (wire.bus_bit_rate > 0) {
    path.wire_extra_ns =
        static_cast<rt::TimeNs>(std::max(0.0, wire.pose_bits - kTimesyncBits) / wire.bus_bit_rate * 1e9);
  }
  path.serial_correction_ns = static_cast<rt::TimeNs>(kPoseBytes * kLineBitsPerByte / wire.tunnel_baud * 1e9);
  return path;
}

bool BusAccount::left(std::uint64_t newest_number_sent) {
  if (!under_way_ || newest_number_sent != pose_.number) return false;
  under_way_ = false;
  return true;
}

PoseDeparture BusAccount::account(rt::TimeNs t_sent_ns, const LatencyPath& path) {
  PoseDeparture departure;
  if (pose_.t_published_ns != 0) {
    own_time_.add(t_sent_ns - pose_.t_published_ns);
    departure = {pose_.t_capture_ns, t_sent_ns};
  }
  if (pose_.quality > 0) latency_.add(pose_.t_capture_ns, t_sent_ns, path);
  return departure;
}

const BusFigures& BusAccount::each_second(const TxCounters& tx, double bit_rate, bool gone) {
  figures_.latency = latency_.summary();
  own_time_.sort();
  figures_.own_samples = own_time_.size();
  figures_.own_p50_ms = own_time_.share_ms(0.5);
  figures_.own_p99_ms = own_time_.share_ms(0.99);
  figures_.own_max_ms = own_time_.share_ms(1);
  figures_.load_percent = 100 * (tx.bits - bits_before_) / bit_rate;
  bits_before_ = tx.bits;
  const std::uint64_t drops = tx.abandoned + tx.refused + tx.poses_replaced;
  figures_.trouble = gone || drops != drops_before_;
  drops_before_ = drops;
  return figures_;
}

}  // namespace godwit::link
