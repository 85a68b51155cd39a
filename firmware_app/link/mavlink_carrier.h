// Carries MAVLink to the autopilot and back: split into uavcan.tunnel.Targetted on the bus, or whole through a port.
#pragma once

#include <cstdint>

#include "firmware_app/link/byte_port.h"
#include "firmware_app/link/dronecan/types.h"
#include "firmware_app/link/dronecan_node.h"
#include "firmware_app/link/mavlink_endpoint.h"
#include "firmware_app/link/parameters.h"
#include "firmware_app/link/tx_queue.h"

namespace godwit::link {

/// Its neighbours outlive it. One thread; no allocation.
class MavlinkCarrier final : public mavlink::Carrier {
 public:
  /// port: null for the tunnel.
  MavlinkCarrier(BytePort* port, const ParameterSet* parameters, const dronecan::Node* node, TxQueue* queue)
      : port_(port), parameters_(parameters), node_(node), queue_(queue) {}

  bool send(std::span<const std::uint8_t> frame, TxClass tx_class, rt::TimeNs now_ns) override;
  /// Number in the queue of the message sent last; 0: it went through the port, or was dropped.
  std::uint64_t last_queued() const { return last_queued_; }
  /// Whether a transfer is one of the tunnel's for us, from the autopilot; its bytes are then in *out.
  bool take(const dronecan::Transfer& transfer, dronecan::TunnelTargetted* out) const;

 private:
  void send_through_tunnel(std::span<const std::uint8_t> frame, TxClass tx_class, rt::TimeNs now_ns);

  BytePort* port_;
  const ParameterSet* parameters_;
  const dronecan::Node* node_;
  TxQueue* queue_;
  std::uint8_t transfer_id_ = 0;
  std::uint64_t last_queued_ = 0;
};

}  // namespace godwit::link
