#include "firmware_app/link/mavlink_carrier.h"

#include <algorithm>
#include <array>

namespace godwit::link {
namespace {
constexpr std::uint8_t kTunnelPriority = 16;
}  // namespace

bool MavlinkCarrier::send(std::span<const std::uint8_t> frame, TxClass tx_class, rt::TimeNs now_ns) {
  last_queued_ = 0;
  if (port_ != nullptr) return port_->send(frame, tx_class);
  send_through_tunnel(frame, tx_class, now_ns);
  return last_queued_ != 0;
}

void MavlinkCarrier::send_through_tunnel(std::span<const std::uint8_t> frame, TxClass tx_class, rt::TimeNs now_ns) {
  if (node_->node_id() == 0 || !queue_->begin(tx_class, now_ns)) return;
  const bool fd = parameters_->get(Parameter::kCanFd) != 0;
  dronecan::TunnelTargetted tunnel;
  tunnel.protocol = static_cast<std::uint8_t>(dronecan::TunnelProtocol::kMavlink2);
  tunnel.target_node = static_cast<std::uint8_t>(parameters_->get(Parameter::kAutopilotNode));
  tunnel.serial_id = static_cast<std::int8_t>(parameters_->get(Parameter::kSerialIndex));
  tunnel.options = dronecan::TunnelTargetted::kLockPort;
  tunnel.baudrate = static_cast<std::uint32_t>(parameters_->get(Parameter::kBaudRate));
  while (!frame.empty()) {
    tunnel.buffer.size = std::min(frame.size(), dronecan::TunnelTargetted::kMaxBuffer);
    std::copy_n(frame.begin(), tunnel.buffer.size, tunnel.buffer.item.begin());
    frame = frame.subspan(tunnel.buffer.size);
    std::array<std::uint8_t, dronecan::kMaxPayload> payload;
    dronecan::Transfer t;
    t.type_id = dronecan::TunnelTargetted::kType.id;
    t.priority = kTunnelPriority;
    t.source = node_->node_id();
    t.fd = fd;
    t.payload = {payload.data(), dronecan::encode(tunnel, payload, fd)};
    queue_->add(t, dronecan::TunnelTargetted::kType.signature, &transfer_id_);
  }
  last_queued_ = queue_->commit();
}

bool MavlinkCarrier::take(const dronecan::Transfer& transfer, dronecan::TunnelTargetted* out) const {
  return port_ == nullptr && transfer.source == parameters_->get(Parameter::kAutopilotNode) &&
         dronecan::decode(transfer.payload, transfer.fd, out) && out->target_node == node_->node_id() &&
         out->serial_id == parameters_->get(Parameter::kSerialIndex);
}

}  // namespace godwit::link
