#include "firmware_app/output/base64.h"

#include <array>

namespace godwit::app {
namespace {

constexpr std::string_view kDigits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

constexpr std::array<std::int8_t, 256> values_of_digits() {
  std::array<std::int8_t, 256> out{};
  for (std::int8_t& value : out) value = -1;
  for (std::size_t i = 0; i < kDigits.size(); ++i) {
    out[static_cast<std::uint8_t>(kDigits[i])] = static_cast<std::int8_t>(i);
  }
  return out;
}
constexpr std::array<std::int8_t, 256> kValues = values_of_digits();

}  // namespace

void append_base64(std::span<const std::uint8_t> bytes, std::string* out) {
  const std::size_t begin = out->size();
  out->resize(begin + (bytes.size() + 2) / 3 * 4, '=');
  char* to = out->data() + begin;
  const auto put = [&to](std::uint32_t three, int digits) {
    for (int i = 0; i < digits; ++i) *to++ = kDigits[(three >> (18 - 6 * i)) & 63U];
  };
  std::size_t i = 0;
  for (; i + 3 <= bytes.size(); i += 3) {
    put(std::uint32_t{bytes[i]} << 16U | std::uint32_t{bytes[i + 1]} << 8U | bytes[i + 2], 4);
  }
  const std::size_t rest = bytes.size() - i;
  if (rest == 1) put(std::uint32_t{bytes[i]} << 16U, 2);
  if (rest == 2) put(std::uint32_t{bytes[i]} << 16U | std::uint32_t{bytes[i + 1]} << 8U, 3);
}

std::optional<std::vector<std::uint8_t>> from_base64(std::string_view text) {
  if (text.size() % 4 != 0) return std::nullopt;
  const std::size_t padding = text.ends_with("==") ? 2 : text.ends_with('=') ? 1 : 0;
  const std::size_t digits = text.size() - padding;
  std::vector<std::uint8_t> out;
  out.reserve(digits * 3 / 4);
  std::uint32_t bits = 0;
  for (std::size_t i = 0; i < digits; ++i) {
    const std::int8_t value = kValues[static_cast<std::uint8_t>(text[i])];
    if (value < 0) return std::nullopt;
    bits = bits << 6U | static_cast<std::uint32_t>(value);
    // Three bytes of four digits: each digit but the first of a group completes one.
    if (i % 4 != 0) out.push_back(static_cast<std::uint8_t>(bits >> (6 - 2 * (i % 4))));
  }
  return out;
}

}  // namespace godwit::app
