// One CAN frame, classic or FD, and the lengths that CAN FD knows.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace godwit::hal {

constexpr std::size_t kClassicCanBytes = 8;
constexpr std::size_t kFdCanBytes = 64;

struct CanFrame {
  std::uint32_t id = 0;     ///< 29 bits where extended, else 11
  bool extended = true;     ///< 29-bit identifier
  bool fd = false;          ///< CAN FD frame (sent with bit-rate switch)
  std::uint8_t length = 0;  ///< bytes used of data: 0 to 8, FD 0 to 64
  std::array<std::uint8_t, kFdCanBytes> data{};
};

/// Smallest length a CAN FD frame can have that holds `bytes` (0 to 64): 0..8, 12, 16, 20, 24, 32, 48, 64.
constexpr std::size_t fd_frame_length(std::size_t bytes) {
  if (bytes <= 8) return bytes;
  if (bytes <= 24) return (bytes + 3) / 4 * 4;
  if (bytes <= 32) return 32;
  if (bytes <= 48) return 48;
  return kFdCanBytes;
}

}  // namespace godwit::hal
