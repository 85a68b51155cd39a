#include "firmware_app/link/mavlink/codec.h"

#include <optional>

#include "firmware_app/link/mavlink/messages.h"

namespace godwit::link::mavlink {
namespace {

constexpr std::uint8_t kFlagSigned = 1;

constexpr std::array<std::uint16_t, 256> make_table() {
  std::array<std::uint16_t, 256> table{};
  for (unsigned i = 0; i < 256; ++i) {
    unsigned crc = i;
    for (int bit = 0; bit < 8; ++bit) crc = (crc & 1U) ? crc >> 1 ^ 0x8408U : crc >> 1;
    table[i] = static_cast<std::uint16_t>(crc);
  }
  return table;
}
constexpr auto kTable = make_table();

std::optional<std::uint8_t> crc_extra(std::uint32_t id) {
  std::optional<std::uint8_t> extra;
  for_each_message([&]<typename Message>() {
    if (Message::kId == id) extra = Message::kCrcExtra;
  });
  return extra;
}

}  // namespace

std::uint16_t crc_x25(std::span<const std::uint8_t> bytes, std::uint16_t crc) {
  for (const std::uint8_t byte : bytes) crc = static_cast<std::uint16_t>(crc >> 8 ^ kTable[(crc ^ byte) & 0xFFU]);
  return crc;
}

void Parser::drop(std::size_t bytes) {
  std::copy(buffer_.begin() + static_cast<std::ptrdiff_t>(bytes), buffer_.begin() + static_cast<std::ptrdiff_t>(size_),
            buffer_.begin());
  size_ -= bytes;
}

std::size_t Parser::find(RawMessage* message) {
  for (;;) {
    const auto begin = buffer_.begin();
    const auto magic = std::find(begin, begin + static_cast<std::ptrdiff_t>(size_), kMagic);
    if (magic != begin) {
      const std::size_t noise = magic - begin;
      counters_.skipped_bytes += noise;
      drop(noise);
    }
    if (size_ < kHeaderBytes) return 0;
    const std::uint8_t* p = buffer_.data();
    const std::uint8_t flags = p[2];
    // A frame that turns out bad is left by one byte only: a good one may begin inside it.
    if ((flags & ~kFlagSigned) != 0) {
      ++counters_.incompatible;
      ++counters_.skipped_bytes;
      drop(1);
      continue;
    }
    const std::size_t payload = p[1];
    const std::size_t checked = kHeaderBytes + payload;
    const std::size_t length = checked + kCrcBytes + ((flags & kFlagSigned) != 0 ? kSignatureBytes : 0);
    if (size_ < length) return 0;
    message->id = p[7] | static_cast<std::uint32_t>(p[8]) << 8 | static_cast<std::uint32_t>(p[9]) << 16;
    const std::optional<std::uint8_t> extra = crc_extra(message->id);
    if (!extra) {
      ++counters_.unknown;
      drop(length);
      continue;
    }
    const std::uint8_t extra_byte = *extra;
    const std::uint16_t crc = crc_x25({&extra_byte, 1}, crc_x25({p + 1, checked - 1}));
    if (crc != (p[checked] | p[checked + 1] << 8)) {
      ++counters_.bad_crc;
      ++counters_.skipped_bytes;
      drop(1);
      continue;
    }
    message->sequence = p[4];
    message->system = p[5];
    message->component = p[6];
    message->is_signed = (flags & kFlagSigned) != 0;
    message->payload = {p + kHeaderBytes, payload};
    ++counters_.messages;
    return length;
  }
}

}  // namespace godwit::link::mavlink
