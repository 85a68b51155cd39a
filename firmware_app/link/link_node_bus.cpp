// LinkNode's side towards bus and port: what arrives and where it goes.
#include <array>

#include "firmware_app/link/dronecan/types.h"
#include "firmware_app/link/link_node.h"

namespace godwit::link {
void LinkNode::receive(rt::TimeNs now_ns) {
  if (ports_.bus != nullptr) {
    ports_.bus->maintain(now_ns);
    hal::CanFrame frame;
    dronecan::Transfer transfer;
    for (int i = 0; i < kMaxFramesPerStep && ports_.bus->receive(&frame); ++i) {
      if (reassembler_.accept(frame, now_ns, &transfer)) take_transfer(transfer, now_ns);
    }
  }
  if (ports_.bytes != nullptr) {
    std::array<std::uint8_t, 2048> bytes;
    for (int i = 0; i < 16; ++i) {
      const std::size_t size = ports_.bytes->receive(bytes);
      if (size == 0) break;
      endpoint_.receive({bytes.data(), size}, now_ns);
    }
    ports_.bytes->maintain(now_ns);
    ports_.bytes->flush();
  }
}

void LinkNode::take_transfer(const dronecan::Transfer& transfer, rt::TimeNs now_ns) {
  const bool message = transfer.kind == dronecan::TransferKind::kMessage;
  if (message && transfer.type_id == dronecan::NodeStatus::kType.id) {
    // A bus gives nobody his own frames back.
    if (transfer.source != 0 && transfer.source == node_.node_id()) t_own_id_ns_ = now_ns;
    return;
  }
  if (message && transfer.source != 0) {
    dronecan::TunnelTargetted tunnel;
    if (transfer.type_id == dronecan::TunnelTargetted::kType.id) {
      if (carrier_.take(transfer, &tunnel)) endpoint_.receive(tunnel.buffer.view(), now_ns);
      return;
    }
    if (transfer.type_id == dronecan::ArmingStatus::kType.id) {
      dronecan::ArmingStatus status;
      if (transfer.source != parameters_.get(Parameter::kAutopilotNode) ||
          !dronecan::decode(transfer.payload, transfer.fd, &status)) {
        return;
      }
      arming_.heard_status(status.status == dronecan::ArmingStatus::kFullyArmed, now_ns);
      return;
    }
    AutopilotInput input;
    if (input_from_dronecan(transfer, &input)) {
      input.t_arrival_ns = now_ns;
      if (ports_.inputs != nullptr) ports_.inputs->try_push(input);
      return;
    }
  }
  node_.handle(transfer, now_ns, armed(now_ns));
  filters_.follow(node_.node_id(), ports_.bus, &reassembler_);
}

bool LinkNode::armed(rt::TimeNs now_ns) const {
  return arming_.armed(endpoint_.armed(), endpoint_.t_heartbeat_ns(), now_ns);
}

}  // namespace godwit::link
