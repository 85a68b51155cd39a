// Bytes as text (RFC 4648, section 4), for pictures inside lines of JSON.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace godwit::app {

/// Appends them, padded, without line breaks.
void append_base64(std::span<const std::uint8_t> bytes, std::string* out);

/// Nothing: it is none, or its padding is wrong.
std::optional<std::vector<std::uint8_t>> from_base64(std::string_view text);

}  // namespace godwit::app
