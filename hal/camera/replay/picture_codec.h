// JPEG and PNG out of memory, with libjpeg-turbo and libpng.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace godwit::hal {

/// A picture as it was stored, 8 bits a channel, rows without padding.
struct DecodedPicture {
  int width = 0, height = 0;
  int channels = 0;  ///< 1 grey, 3 BGR
  std::vector<std::uint8_t> pixels;
};

/// Larger ones are refused by their header, before memory is taken for them.
constexpr int kWidestPicture = 8192;

/// Decodes a JPEG or a PNG; transparency is left out, orientation as stored. Memory of *out is used again. Returns what
/// is wrong in words: neither of the two, broken, too large, other than 8 bits grey or colour; empty: nothing.
/// Allocates: feeder threads only.
std::string decode_picture(std::span<const std::uint8_t> bytes, DecodedPicture* out);

bool is_jpeg(std::span<const std::uint8_t> bytes);
bool is_png(std::span<const std::uint8_t> bytes);

}  // namespace godwit::hal
