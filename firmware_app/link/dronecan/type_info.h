// What names a DroneCAN data type on the bus.
#pragma once

#include <cstddef>
#include <cstdint>

namespace godwit::link::dronecan {

enum class TransferKind : std::uint8_t { kMessage, kRequest, kResponse };

struct TypeInfo {
  const char* name = "";  ///< full DSDL name
  TransferKind kind = TransferKind::kMessage;
  std::uint16_t id = 0;
  std::uint64_t signature = 0;  ///< of the normalised DSDL; enters the CRC of multi-frame transfers
  std::size_t max_bytes = 0;    ///< longest payload, with array lengths
};

}  // namespace godwit::link::dronecan
