// Turns the data types of types.h into payload bytes and back. Each type lists its fields once, in DSDL order; the two
// visitors here, and the test's printer, walk that one list.
#pragma once

#include <array>
#include <concepts>
#include <cstdint>
#include <limits>
#include <string_view>
#include <type_traits>

#include "firmware_app/link/dronecan/bits.h"

namespace godwit::link::dronecan {

/// A dynamic array of at most N items.
template <typename T, std::size_t N>
struct List {
  std::size_t size = 0;
  std::array<T, N> item{};
  static constexpr unsigned kLengthBits = std::bit_width(N);

  std::span<const T> view() const { return {item.data(), size}; }
};

template <std::size_t N>
using Bytes = List<std::uint8_t, N>;

/// Copies what fits.
template <std::size_t N>
void assign(Bytes<N>* to, std::string_view text) {
  to->size = std::min(N, text.size());
  std::copy_n(text.begin(), to->size, to->item.begin());
}

template <std::size_t N>
std::string_view text_of(const Bytes<N>& bytes) {
  return {reinterpret_cast<const char*>(bytes.item.data()), bytes.size};
}

/// Where an array stands: the last one of the outermost type carries no length on classic CAN (tail-array
/// optimisation).
enum class Tail : std::uint8_t { kNo, kYes };

/// How a number too large for its field is made to fit.
enum class Cast : std::uint8_t { kSaturated, kTruncated };

class Encoder {
 public:
  /// tail_optimisation: true on classic CAN, false on CAN FD.
  Encoder(std::span<std::uint8_t> out, bool tail_optimisation) : bits_(out), optimise_(tail_optimisation) {}

  template <std::unsigned_integral T>
  void number(const char*, const T& value, unsigned bits, Cast cast = Cast::kSaturated) {
    const std::uint64_t most = bits == 64 ? ~std::uint64_t{0} : (std::uint64_t{1} << bits) - 1;
    const std::uint64_t wide = value;
    bits_.write(cast == Cast::kSaturated ? std::min(wide, most) : wide & most, bits);
  }
  template <std::signed_integral T>
  void number(const char*, const T& value, unsigned bits) {
    const std::int64_t most = std::numeric_limits<std::int64_t>::max() >> (64 - bits);
    bits_.write(static_cast<std::uint64_t>(std::clamp<std::int64_t>(value, -most - 1, most)), bits);
  }
  void boolean(const char*, const bool& value) { bits_.write(value ? 1 : 0, 1); }
  void half(const char*, const float& value) { bits_.write(half_from_float(value), 16); }
  void single(const char*, const float& value) {
    // Saturated as DSDL wants it: infinity becomes the largest finite number.
    constexpr float kMost = std::numeric_limits<float>::max();
    bits_.write(std::bit_cast<std::uint32_t>(value > kMost ? kMost : value < -kMost ? -kMost : value), 32);
  }
  void padding(unsigned bits) { bits_.write(0, bits); }
  template <typename T, std::size_t N, typename Item>
  void list(const char*, const List<T, N>& value, Tail tail, unsigned, Item item) {
    if (tail == Tail::kNo || !optimise_) bits_.write(value.size, List<T, N>::kLengthBits);
    for (std::size_t i = 0; i < std::min(value.size, N); ++i) item(*this, value.item[i]);
  }
  template <std::size_t N>
  void bytes(const char*, const Bytes<N>& value, Tail tail) {
    write_bytes(value.view(), Bytes<N>::kLengthBits, tail);
  }
  template <typename T>
  void nested(const char*, const T& value) {
    T::visit(*this, value);
  }
  bool ok() const { return bits_.ok(); }
  std::size_t size() const { return bits_.bytes(); }

 private:
  void write_bytes(std::span<const std::uint8_t> bytes, unsigned length_bits, Tail tail) {
    if (tail == Tail::kNo || !optimise_) bits_.write(bytes.size(), length_bits);
    for (const std::uint8_t byte : bytes) bits_.write(byte, 8);
  }

  BitWriter bits_;
  bool optimise_;
};

class Decoder {
 public:
  Decoder(std::span<const std::uint8_t> in, bool tail_optimisation) : bits_(in), optimise_(tail_optimisation) {}

  template <std::unsigned_integral T>
  void number(const char*, T& value, unsigned bits, Cast = Cast::kSaturated) {
    value = static_cast<T>(bits_.read(bits));
  }
  template <std::signed_integral T>
  void number(const char*, T& value, unsigned bits) {
    const unsigned unused = 64 - bits;
    value = static_cast<T>(static_cast<std::int64_t>(bits_.read(bits) << unused) >> unused);
  }
  void boolean(const char*, bool& value) { value = bits_.read(1) != 0; }
  void half(const char*, float& value) { value = float_from_half(static_cast<std::uint16_t>(bits_.read(16))); }
  void single(const char*, float& value) { value = std::bit_cast<float>(static_cast<std::uint32_t>(bits_.read(32))); }
  void padding(unsigned bits) { bits_.read(bits); }
  /// item_bits: length of one item, from which the count of an optimised tail array follows.
  template <typename T, std::size_t N, typename Item>
  void list(const char*, List<T, N>& value, Tail tail, unsigned item_bits, Item item) {
    value.size = tail == Tail::kYes && optimise_ ? bits_.left() / item_bits : bits_.read(List<T, N>::kLengthBits);
    if (value.size > N) {
      value.size = 0;
      bits_.fail();
      return;
    }
    for (std::size_t i = 0; i < value.size; ++i) item(*this, value.item[i]);
  }
  template <std::size_t N>
  void bytes(const char*, Bytes<N>& value, Tail tail) {
    value.size = read_bytes(value.item, Bytes<N>::kLengthBits, tail);
  }
  template <typename T>
  void nested(const char*, T& value) {
    T::visit(*this, value);
  }
  bool ok() const { return bits_.ok(); }

 private:
  std::size_t read_bytes(std::span<std::uint8_t> to, unsigned length_bits, Tail tail) {
    const std::size_t size = tail == Tail::kYes && optimise_ ? bits_.left() / 8 : bits_.read(length_bits);
    if (size > to.size()) {
      bits_.fail();
      return 0;
    }
    for (std::size_t i = 0; i < size; ++i) to[i] = static_cast<std::uint8_t>(bits_.read(8));
    return size;
  }

  BitReader bits_;
  bool optimise_;
};

/// Writes a value; returns the number of bytes, 0 where it did not fit (or where the type is empty). No allocation.
template <typename T>
std::size_t encode(const T& value, std::span<std::uint8_t> out, bool fd) {
  Encoder encoder(out, !fd);
  T::visit(encoder, value);
  return encoder.ok() ? encoder.size() : 0;
}

/// Reads a value; false where the payload is too short or an array too long. Bytes behind the value are CAN FD's
/// padding or a newer version's fields, and are let be. No allocation.
template <typename T>
bool decode(std::span<const std::uint8_t> payload, bool fd, T* value) {
  Decoder decoder(payload, !fd);
  T::visit(decoder, *value);
  return decoder.ok();
}

}  // namespace godwit::link::dronecan
