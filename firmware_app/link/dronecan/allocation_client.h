// Asks an allocator for a node id (uavcan.protocol.dynamic_node_id.Allocation, DroneCAN specification 5.3.1.3): the
// unique id goes out in three anonymous frames, each sent when the allocator has repeated what it has so far.
#pragma once

#include <cstdint>

#include "firmware_app/link/dronecan/types.h"
#include "hal/rt/time.h"

namespace godwit::link::dronecan {

class AllocationClient {
 public:
  /// preferred: the id to ask for, 0 for any.
  AllocationClient(const UniqueId& unique_id, std::uint8_t preferred);

  /// True where a request is to be sent now; *request is it.
  bool step(rt::TimeNs now_ns, Allocation* request);
  /// Takes an Allocation message from the bus; source 0: another node's request, which makes us wait.
  void take(const Allocation& message, std::uint8_t source, rt::TimeNs now_ns);
  /// The id we were given, 0 while there is none.
  std::uint8_t node_id() const { return node_id_; }

 private:
  rt::TimeNs random_ns(std::int64_t low_ms, std::int64_t high_ms);

  UniqueId unique_id_;
  std::uint8_t preferred_;
  std::uint8_t node_id_ = 0;
  std::size_t offset_ = 0;    // bytes of the unique id that the allocator has
  rt::TimeNs t_next_ns_ = 0;  // 0: not scheduled yet
  std::uint64_t random_state_;
};

}  // namespace godwit::link::dronecan
