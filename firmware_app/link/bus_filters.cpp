#include "firmware_app/link/bus_filters.h"

#include <array>
#include <cstddef>
#include <initializer_list>

#include "firmware_app/link/dronecan/types.h"

namespace godwit::link {

void BusFilters::follow(std::uint8_t node_id, hal::CanBus* bus, dronecan::Reassembler* reassembler) {
  if (set_ && node_id == node_id_) return;
  set_ = true;
  node_id_ = node_id;
  reassembler->set_node_id(node_id);
  if (bus == nullptr) return;
  // The reassembler does it again, so that a bus without filters is no danger.
  std::array<hal::CanFilter, hal::CanBus::kMaxFilters> filters{};
  std::size_t count = 0;
  const auto let_in = [&](std::initializer_list<std::uint16_t> types) {
    for (const std::uint16_t type : types) {
      filters[count++] = {static_cast<std::uint32_t>(type) << 8, 0x00FFFF80, true};
    }
  };
  let_in({dronecan::TunnelTargetted::kType.id, dronecan::ArmingStatus::kType.id, dronecan::Allocation::kType.id});
  if (inputs_) {
    let_in({dronecan::RangeMeasurement::kType.id, dronecan::StaticPressure::kType.id, dronecan::GnssFix2::kType.id,
            dronecan::RawImu::kType.id, dronecan::GlobalTimeSync::kType.id});
  }
  if (node_id != 0) {
    filters[count++] = {node_id * 256U | 0x80U, 0x00007F80, true};
    // Whoever speaks under our id.
    filters[count++] = {static_cast<std::uint32_t>(dronecan::NodeStatus::kType.id) << 8 | node_id, 0x00FFFFFF, true};
  }
  // Requests by other anonymous nodes: type 1 in the two lowest bits of the type field.
  filters[count++] = {1U << 8, 0x000003FF, true};
  // A refusal leaves the bus unfiltered, which costs time and nothing else.
  static_cast<void>(bus->set_filters({filters.data(), count}).ok());
}

}  // namespace godwit::link
