// LinkNode's side towards bus and port: what arrives and where it goes, and MAVLink through the tunnel.
#include <algorithm>

#include "firmware_app/link/dronecan/types.h"
#include "firmware_app/link/link_node.h"

namespace godwit::link {
namespace {
constexpr std::uint8_t kTunnelPriority = 16;
constexpr rt::TimeNs kArmingStatusAgeNs = 5 * rt::kNsPerSecond;
}  // namespace

void LinkNode::set_bus_filters() {
  filters_for_node_ = node_.node_id();
  reassembler_.set_node_id(filters_for_node_);
  if (ports_.bus == nullptr) return;
  // The kernel sorts out what is not for us; the reassembler does it again, so that a bus without filters is no danger.
  std::array<hal::CanFilter, hal::CanBus::kMaxFilters> filters{};
  std::size_t count = 0;
  for (const std::uint16_t type :
       {dronecan::TunnelTargetted::kType.id, dronecan::RangeMeasurement::kType.id, dronecan::StaticPressure::kType.id,
        dronecan::RawImu::kType.id, dronecan::ArmingStatus::kType.id, dronecan::GlobalTimeSync::kType.id,
        dronecan::Allocation::kType.id}) {
    filters[count++] = {static_cast<std::uint32_t>(type) << 8, 0x00FFFF80, true};
  }
  if (filters_for_node_ != 0) filters[count++] = {filters_for_node_ * 256U | 0x80U, 0x00007F80, true};
  // Whoever speaks under our id.
  if (filters_for_node_ != 0) {
    filters[count++] = {static_cast<std::uint32_t>(dronecan::NodeStatus::kType.id) << 8 | filters_for_node_, 0x00FFFFFF,
                        true};
  }
  // Requests by other anonymous nodes: type 1 in the two lowest bits of the type field.
  filters[count++] = {1U << 8, 0x000003FF, true};
  // A refusal leaves the bus unfiltered, which costs time and nothing else.
  static_cast<void>(ports_.bus->set_filters({filters.data(), count}).ok());
}

bool LinkNode::LinkCarrier::send(std::span<const std::uint8_t> frame, TxClass tx_class, rt::TimeNs now_ns) {
  if (link_->ports_.bytes != nullptr) return link_->ports_.bytes->send(frame, tx_class);
  return link_->send_through_tunnel(frame, tx_class, now_ns);
}

bool LinkNode::send_through_tunnel(std::span<const std::uint8_t> frame, TxClass tx_class, rt::TimeNs now_ns) {
  if (node_.node_id() == 0 || !queue_.begin(tx_class, now_ns)) return false;
  const bool fd = parameters_.get(Parameter::kCanFd) != 0;
  dronecan::TunnelTargetted tunnel;
  tunnel.protocol = static_cast<std::uint8_t>(dronecan::TunnelProtocol::kMavlink2);
  tunnel.target_node = static_cast<std::uint8_t>(parameters_.get(Parameter::kAutopilotNode));
  tunnel.serial_id = static_cast<std::int8_t>(parameters_.get(Parameter::kSerialIndex));
  tunnel.options = dronecan::TunnelTargetted::kLockPort;
  tunnel.baudrate = static_cast<std::uint32_t>(parameters_.get(Parameter::kBaudRate));
  while (!frame.empty()) {
    tunnel.buffer.size = std::min(frame.size(), dronecan::TunnelTargetted::kMaxBuffer);
    std::copy_n(frame.begin(), tunnel.buffer.size, tunnel.buffer.item.begin());
    frame = frame.subspan(tunnel.buffer.size);
    std::array<std::uint8_t, dronecan::kMaxPayload> payload;
    dronecan::Transfer t;
    t.type_id = dronecan::TunnelTargetted::kType.id;
    t.priority = kTunnelPriority;
    t.source = node_.node_id();
    t.fd = fd;
    t.payload = {payload.data(), dronecan::encode(tunnel, payload, fd)};
    queue_.add(t, dronecan::TunnelTargetted::kType.signature, &tunnel_transfer_id_);
  }
  last_carried_ = queue_.commit();
  return last_carried_ != 0;
}

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
    status_.own_id_heard = status_.own_id_heard || (transfer.source != 0 && transfer.source == node_.node_id());
    return;
  }
  if (message && transfer.source != 0) {
    if (transfer.type_id == dronecan::TunnelTargetted::kType.id) return take_tunnel(transfer, now_ns);
    if (transfer.type_id == dronecan::ArmingStatus::kType.id) {
      dronecan::ArmingStatus status;
      if (transfer.source != parameters_.get(Parameter::kAutopilotNode) ||
          !dronecan::decode(transfer.payload, transfer.fd, &status)) {
        return;
      }
      arming_status_armed_ = status.status == dronecan::ArmingStatus::kFullyArmed;
      t_arming_status_ns_ = now_ns;
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
  if (node_.node_id() != filters_for_node_) set_bus_filters();
}

void LinkNode::take_tunnel(const dronecan::Transfer& transfer, rt::TimeNs now_ns) {
  dronecan::TunnelTargetted tunnel;
  if (ports_.bytes != nullptr || transfer.source != parameters_.get(Parameter::kAutopilotNode) ||
      !dronecan::decode(transfer.payload, transfer.fd, &tunnel) || tunnel.target_node != node_.node_id() ||
      tunnel.serial_id != parameters_.get(Parameter::kSerialIndex)) {
    return;
  }
  endpoint_.receive(tunnel.buffer.view(), now_ns);
}

// Locked while the newest word on it, by ArmingStatus or HEARTBEAT, says armed; and for as long as nobody says
// otherwise, because an autopilot that falls silent may still be flying.
bool LinkNode::armed(rt::TimeNs now_ns) const {
  const bool by_status = t_arming_status_ns_ != 0 && arming_status_armed_;
  const bool by_heartbeat = endpoint_.t_heartbeat_ns() != 0 && endpoint_.armed();
  if (by_status == by_heartbeat) return by_status;
  const rt::TimeNs t_yes = by_status ? t_arming_status_ns_ : endpoint_.t_heartbeat_ns();
  const rt::TimeNs t_no = by_status ? endpoint_.t_heartbeat_ns() : t_arming_status_ns_;
  const bool outdated = now_ns - t_yes > kArmingStatusAgeNs && t_no > t_yes;
  return !outdated;
}

}  // namespace godwit::link
