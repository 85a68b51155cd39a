// CRC-16-CCITT-FALSE (polynomial 0x1021, initial value 0xFFFF, no reflection): the checksum of DroneCAN transfers and
// of the multicast datagrams.
#pragma once

#include <array>
#include <cstdint>
#include <span>

namespace godwit::hal {

constexpr std::uint16_t kCrc16Initial = 0xFFFF;

namespace detail {
constexpr std::array<std::uint16_t, 256> make_crc16_table() {
  std::array<std::uint16_t, 256> table{};
  for (unsigned i = 0; i < 256; ++i) {
    unsigned crc = i << 8;
    for (int bit = 0; bit < 8; ++bit) crc = (crc & 0x8000U) ? (crc << 1) ^ 0x1021U : crc << 1;
    table[i] = static_cast<std::uint16_t>(crc);
  }
  return table;
}
inline constexpr auto kCrc16Table = make_crc16_table();
}  // namespace detail

/// Continues `crc` over one byte. No allocation, any thread.
constexpr std::uint16_t crc16_add(std::uint16_t crc, std::uint8_t byte) {
  return static_cast<std::uint16_t>((crc << 8) ^ detail::kCrc16Table[(crc >> 8) ^ byte]);
}

/// Continues `crc` over bytes. No allocation, any thread.
constexpr std::uint16_t crc16(std::span<const std::uint8_t> bytes, std::uint16_t crc = kCrc16Initial) {
  for (const std::uint8_t byte : bytes) crc = crc16_add(crc, byte);
  return crc;
}

}  // namespace godwit::hal
