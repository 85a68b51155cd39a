// DroneCAN's bit stream: bits pack most significant first within a byte, scalars of several bytes go least significant
// byte first, the incomplete byte of a scalar last and left-aligned.
#pragma once

#include <algorithm>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <span>

namespace godwit::link::dronecan {

/// float32 to IEEE half as DroneCAN does it: saturated to +-65504 (DSDL's default cast), ties away from zero, NaN kept.
inline std::uint16_t half_from_float(float value) {
  const auto bits = std::bit_cast<std::uint32_t>(value);
  const std::uint32_t sign = bits & 0x80000000U;
  const std::uint32_t magnitude = bits ^ sign;
  std::uint32_t half = 0;
  if (magnitude > 0x7F800000U) {
    half = 0x7FFF;
  } else {
    // Scaling by 2^-112 puts the exponent where a half has it, and lets the processor make the denormals.
    const float clamped = std::min(std::bit_cast<float>(magnitude), 65504.0F);
    const auto cut = std::bit_cast<std::uint32_t>(clamped) & 0xFFFFF000U;
    half = (std::bit_cast<std::uint32_t>(std::bit_cast<float>(cut) * 0x1p-112F) + 0x1000U) >> 13;
  }
  return static_cast<std::uint16_t>(half | sign >> 16);
}

/// IEEE half to float32; infinities and NaN survive.
inline float float_from_half(std::uint16_t half) {
  const std::uint32_t magnitude = half & 0x7FFFU;
  std::uint32_t bits = std::bit_cast<std::uint32_t>(std::bit_cast<float>(magnitude << 13) * 0x1p112F);
  if (magnitude >= 0x7C00U) bits = 0x7F800000U | (magnitude & 0x3FFU) << 13;
  return std::bit_cast<float>(bits | static_cast<std::uint32_t>(half & 0x8000U) << 16);
}

/// Writes bits into a buffer of zeros-to-be. Past the end it writes nothing and says so in ok().
class BitWriter {
 public:
  explicit BitWriter(std::span<std::uint8_t> out) : out_(out) {}

  /// The low `bits` (1 to 64) of value.
  void write(std::uint64_t value, unsigned bits) {
    while (bits > 0) {
      const unsigned take = std::min(bits, 8U);
      write_high_first(static_cast<unsigned>(value) & ((1U << take) - 1U), take);
      value >>= 8;
      bits -= take;
    }
  }
  bool ok() const { return ok_; }
  std::size_t bytes() const { return (position_ + 7) / 8; }

 private:
  void write_high_first(unsigned byte, unsigned bits) {
    if (position_ + bits > out_.size() * 8) {
      ok_ = false;
      return;
    }
    const std::size_t at = position_ / 8;
    const auto offset = static_cast<unsigned>(position_ % 8);
    const unsigned window = byte << (16U - bits - offset);  // two bytes from `at` on
    if (offset == 0) out_[at] = 0;
    out_[at] = static_cast<std::uint8_t>(out_[at] | window >> 8);
    if (offset + bits > 8) out_[at + 1] = static_cast<std::uint8_t>(window);
    position_ += bits;
  }

  std::span<std::uint8_t> out_;
  std::size_t position_ = 0;
  bool ok_ = true;
};

/// Reads bits. Past the end it reads zeros and says so in ok().
class BitReader {
 public:
  explicit BitReader(std::span<const std::uint8_t> in) : in_(in) {}

  /// `bits` (1 to 64) as an unsigned number.
  std::uint64_t read(unsigned bits) {
    std::uint64_t value = 0;
    for (unsigned shift = 0; bits > 0; shift += 8) {
      const unsigned take = std::min(bits, 8U);
      value |= static_cast<std::uint64_t>(read_high_first(take)) << shift;
      bits -= take;
    }
    return value;
  }
  /// Bits not yet read.
  std::size_t left() const { return in_.size() * 8 - position_; }
  bool ok() const { return ok_; }
  void fail() { ok_ = false; }

 private:
  unsigned read_high_first(unsigned bits) {
    if (position_ + bits > in_.size() * 8) {
      ok_ = false;
      position_ = in_.size() * 8;
      return 0;
    }
    const std::size_t at = position_ / 8;
    const auto offset = static_cast<unsigned>(position_ % 8);
    const unsigned next = at + 1 < in_.size() ? in_[at + 1] : 0U;
    const unsigned window = static_cast<unsigned>(in_[at]) << 8 | next;
    position_ += bits;
    return window >> (16U - bits - offset) & ((1U << bits) - 1U);
  }

  std::span<const std::uint8_t> in_;
  std::size_t position_ = 0;
  bool ok_ = true;
};

}  // namespace godwit::link::dronecan
