// What every MAVLink message tells of itself.
#pragma once

#include <cstddef>
#include <cstdint>

namespace godwit::link::mavlink {

/// Number of a message, the byte that its definition adds to the checksum, and its full length with extensions.
template <std::uint32_t Id, std::uint8_t CrcExtra, std::size_t Length>
struct MessageInfo {
  static constexpr std::uint32_t kId = Id;
  static constexpr std::uint8_t kCrcExtra = CrcExtra;
  static constexpr std::size_t kLength = Length;
};

}  // namespace godwit::link::mavlink
