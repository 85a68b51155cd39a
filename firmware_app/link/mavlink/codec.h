// MAVLink 2 framing: messages of messages.h to bytes and back (https://mavlink.io/en/guide/serialization.html).
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <concepts>
#include <cstdint>
#include <cstring>
#include <span>
#include <type_traits>

namespace godwit::link::mavlink {

constexpr std::uint8_t kMagic = 0xFD;
constexpr std::size_t kHeaderBytes = 10;
constexpr std::size_t kCrcBytes = 2;
constexpr std::size_t kSignatureBytes = 13;
constexpr std::size_t kMaxMessageBytes = kHeaderBytes + 255 + kCrcBytes + kSignatureBytes;

/// CRC-16/MCRF4XX (X.25 without the final inversion) over bytes.
std::uint16_t crc_x25(std::span<const std::uint8_t> bytes, std::uint16_t crc = 0xFFFF);

/// A message as it stood on the wire; the payload belongs to the parser.
struct RawMessage {
  std::uint32_t id = 0;
  std::uint8_t sequence = 0;
  std::uint8_t system = 0;
  std::uint8_t component = 0;
  bool is_signed = false;
  std::span<const std::uint8_t> payload;  ///< trailing zeros cut off
};

namespace detail {

template <typename T>
using Unsigned =
    std::conditional_t<sizeof(T) == 1, std::uint8_t,
                       std::conditional_t<sizeof(T) == 2, std::uint16_t,
                                          std::conditional_t<sizeof(T) == 4, std::uint32_t, std::uint64_t>>>;

class Writer {
 public:
  explicit Writer(std::span<std::uint8_t> out) : out_(out) {}
  template <typename T>
  requires std::is_arithmetic_v<T>
  void field(const char*, const T& value) {
    const auto bits = std::bit_cast<Unsigned<T>>(value);
    for (std::size_t i = 0; i < sizeof(T); ++i) out_[at_++] = static_cast<std::uint8_t>(bits >> (8 * i));
  }
  template <typename T, std::size_t N>
  void field(const char* name, const std::array<T, N>& values) {
    for (const T& value : values) field(name, value);
  }
  std::size_t bytes() const { return at_; }

 private:
  std::span<std::uint8_t> out_;
  std::size_t at_ = 0;
};

class Reader {
 public:
  explicit Reader(std::span<const std::uint8_t> in) : in_(in) {}
  template <typename T>
  requires std::is_arithmetic_v<T>
  void field(const char*, T& value) {
    Unsigned<T> bits = 0;
    for (std::size_t i = 0; i < sizeof(T); ++i, ++at_) {
      const std::uint64_t byte = at_ < in_.size() ? in_[at_] : 0;  // what is missing was zero
      bits = static_cast<Unsigned<T>>(bits | byte << (8 * i));
    }
    value = std::bit_cast<T>(bits);
  }
  template <typename T, std::size_t N>
  void field(const char* name, std::array<T, N>& values) {
    for (T& value : values) field(name, value);
  }

 private:
  std::span<const std::uint8_t> in_;
  std::size_t at_ = 0;
};

}  // namespace detail

using MessageBytes = std::array<std::uint8_t, kMaxMessageBytes>;

/// Who sends, and how many messages it has sent.
struct Sender {
  std::uint8_t system = 1;
  std::uint8_t component = 197;  ///< MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY
  std::uint8_t sequence = 0;
};

/// Writes a whole unsigned MAVLink 2 frame, trailing zeros of the payload cut off (one byte stays), and counts the
/// sender's sequence up. Returns its length. No allocation.
template <typename Message>
std::size_t encode(const Message& message, Sender* sender, MessageBytes* out) {
  detail::Writer writer(std::span<std::uint8_t>(*out).subspan(kHeaderBytes));
  Message::visit(writer, message);
  std::size_t length = writer.bytes();
  while (length > 1 && (*out)[kHeaderBytes + length - 1] == 0) --length;
  std::uint8_t* p = out->data();
  p[0] = kMagic;
  p[1] = static_cast<std::uint8_t>(length);
  p[2] = p[3] = 0;
  p[4] = sender->sequence++;
  p[5] = sender->system;
  p[6] = sender->component;
  for (int i = 0; i < 3; ++i) p[7 + i] = static_cast<std::uint8_t>(Message::kId >> (8 * i));
  const std::uint16_t over_frame = crc_x25({p + 1, kHeaderBytes - 1 + length});
  const std::uint16_t crc = crc_x25({&Message::kCrcExtra, 1}, over_frame);
  p[kHeaderBytes + length] = static_cast<std::uint8_t>(crc);
  p[kHeaderBytes + length + 1] = static_cast<std::uint8_t>(crc >> 8);
  return kHeaderBytes + length + kCrcBytes;
}

/// Reads a message whose id is Message::kId; missing bytes are zero, bytes of newer extensions are passed over.
template <typename Message>
void decode(const RawMessage& raw, Message* message) {
  detail::Reader reader(raw.payload);
  Message::visit(reader, *message);
}

struct ParserCounters {
  std::uint64_t messages = 0;
  std::uint64_t unknown = 0;  ///< whole frames of messages we do not know: their CRC cannot be checked
  std::uint64_t bad_crc = 0;
  std::uint64_t incompatible = 0;  ///< flags this version must not guess at
  std::uint64_t skipped_bytes = 0;
};

/// Finds messages in a byte stream. Bounded work per byte, no allocation. One thread.
class Parser {
 public:
  /// Takes bytes; calls deliver(const RawMessage&) for each known message with a right CRC. Signed frames are taken
  /// without checking the signature: we hold no key, and nothing that flies depends on who sent it.
  template <typename Deliver>
  void feed(std::span<const std::uint8_t> bytes, Deliver&& deliver) {
    while (!bytes.empty()) {
      const std::size_t take = std::min(bytes.size(), buffer_.size() - size_);
      std::copy_n(bytes.begin(), take, buffer_.begin() + static_cast<std::ptrdiff_t>(size_));
      size_ += take;
      bytes = bytes.subspan(take);
      RawMessage message;
      std::size_t length = 0;
      while ((length = find(&message)) > 0) {
        deliver(static_cast<const RawMessage&>(message));
        drop(length);
      }
    }
  }
  const ParserCounters& counters() const { return counters_; }

 private:
  /// Brings the next good message to the buffer's front; returns its length, 0 where more bytes are needed.
  std::size_t find(RawMessage* message);
  void drop(std::size_t bytes);

  ParserCounters counters_;
  std::size_t size_ = 0;
  // Room for one longest message: an incomplete one never fills it, so feed always makes progress.
  std::array<std::uint8_t, 2 * kMaxMessageBytes> buffer_{};
};

}  // namespace godwit::link::mavlink
