// What of the bus is for us: the kernel sorts out the rest.
#pragma once

#include <cstdint>

#include "firmware_app/link/dronecan/transfer.h"
#include "hal/can/can_bus.h"

namespace godwit::link {

/// One thread; no allocation.
class BusFilters {
 public:
  /// inputs: somebody reads what sensors on the bus say; else it is not let in.
  explicit BusFilters(bool inputs) : inputs_(inputs) {}
  /// Sets filters and reassembly to our node id (0: none yet) where it is another than the last one. bus may be null.
  void follow(std::uint8_t node_id, hal::CanBus* bus, dronecan::Reassembler* reassembler);

 private:
  bool inputs_;
  bool set_ = false;
  std::uint8_t node_id_ = 0;
};

}  // namespace godwit::link
