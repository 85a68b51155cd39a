#include "hal/camera/replay/picture_file.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cstring>

#include "hal/record_file.h"

namespace godwit::hal {
namespace {

/// ITU-R BT.601 in 1/32768, as the usual conversions round.
std::uint8_t luma(const std::uint8_t* bgr) {
  return static_cast<std::uint8_t>((3735 * bgr[0] + 19235 * bgr[1] + 9798 * bgr[2] + (1 << 14)) >> 15);
}

}  // namespace

bool picture_is_whole(std::span<const std::uint8_t> bytes) {
  // Writers may pad the end with zeros; IEND itself ends with the CRC AE 42 60 82.
  while (!bytes.empty() && bytes.back() == 0) bytes = bytes.first(bytes.size() - 1);
  if (is_jpeg(bytes)) return bytes.size() >= 4 && bytes[bytes.size() - 2] == 0xFF && bytes.back() == 0xD9;
  if (is_png(bytes)) {
    constexpr std::array<std::uint8_t, 8> kEnd = {'I', 'E', 'N', 'D', 0xAE, 0x42, 0x60, 0x82};
    return bytes.size() >= 20 && std::equal(kEnd.begin(), kEnd.end(), bytes.end() - 8);
  }
  return true;
}

rt::Result<void> PictureDecoder::load(const std::string& file) {
  picture_.width = picture_.height = 0;
  auto bytes = read_whole_file(file);
  if (!bytes) return bytes.error();
  if (bytes.value().empty()) return rt::Error{file + ": the file is empty"};
  if (!picture_is_whole(bytes.value())) return rt::Error{file + ": the picture is cut off"};
  const std::string wrong = decode_picture(bytes.value(), &picture_);
  if (!wrong.empty()) {
    picture_.width = picture_.height = 0;
    return rt::Error{file + ": " + wrong};
  }
  return {};
}

void PictureDecoder::write_grey(const rt::MutableImageView& grey) const {
  const DecodedPicture& p = picture_;
  assert(grey.width == p.width && grey.height == p.height);
  const auto row_bytes = static_cast<std::size_t>(p.width) * static_cast<std::size_t>(p.channels);
  for (int y = 0; y < p.height; ++y) {
    const std::uint8_t* const from = p.pixels.data() + static_cast<std::size_t>(y) * row_bytes;
    std::uint8_t* const to = grey.row(y);
    if (p.channels == 1) {
      std::memcpy(to, from, row_bytes);
    } else {
      for (int x = 0; x < p.width; ++x) to[x] = luma(from + 3 * static_cast<std::ptrdiff_t>(x));
    }
  }
}

void PictureDecoder::write_bgr(std::uint8_t* bgr) const {
  if (picture_.channels == 3) {
    std::memcpy(bgr, picture_.pixels.data(), picture_.pixels.size());
    return;
  }
  for (const std::uint8_t grey : picture_.pixels) {
    std::fill_n(bgr, 3, grey);
    bgr += 3;
  }
}

}  // namespace godwit::hal
